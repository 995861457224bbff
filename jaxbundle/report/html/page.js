"use strict";
// Sorting and searching of tables, the length of arrows, light and dark, and the plan of the block.
const root = document.documentElement;
root.classList.add("js");

document.getElementById("theme").addEventListener("click", () => {
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
  document.dispatchEvent(new Event("theme"));
});

// tables

const numberOf = (cell) => {
  const words = cell.textContent.trim();
  const value = Number(words);
  return words !== "" && Number.isFinite(value) ? value : null;
};

function sort(table, column, button) {
  const head = button.closest("th"), down = head.getAttribute("aria-sort") === "descending";
  for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
  const isName = head.cellIndex >= 0 && table.tBodies[0].rows[0].cells[column].tagName === "TH";
  const first = isName ? 1 : -1;  // names rise, numbers fall: the largest is looked for
  const sign = head.dataset.sorted ? (down ? 1 : -1) : first;
  head.setAttribute("aria-sort", sign < 0 ? "descending" : "ascending");
  head.dataset.sorted = "yes";
  const rows = [...table.tBodies[0].rows].map((row) => [numberOf(row.cells[column]), row.cells[column].textContent, row]);
  rows.sort(([a, s], [b, t]) => {
    if (a !== null && b !== null) return sign * (isName ? a - b : Math.abs(a) - Math.abs(b));
    if (a === null && b === null) return sign * s.localeCompare(t);
    return a === null ? 1 : -1;  // what is not known stands last
  });
  table.tBodies[0].append(...rows.map(([, , row]) => row));
}

for (const table of document.querySelectorAll("table.sortable")) {
  [...table.tHead.rows[0].cells].forEach((cell, column) => {
    const button = cell.querySelector("button");
    button.addEventListener("click", () => sort(table, column, button));
  });
}

for (const input of document.querySelectorAll("input.search")) {
  input.addEventListener("input", () => {
    const wanted = input.value.trim().toLowerCase();
    for (const row of input.nextElementSibling.querySelectorAll("tbody tr")) {
      row.hidden = wanted !== "" && !row.textContent.toLowerCase().includes(wanted);
    }
  });
}

function show(address) {
  const row = document.getElementById(address);
  if (!row) return;
  document.querySelectorAll("tr.marked").forEach((other) => other.classList.remove("marked"));
  row.hidden = false;
  row.classList.add("marked");
  row.scrollIntoView({ block: "center" });
}

// arrows at control and check points

for (const label of document.querySelectorAll(".factor")) {
  const input = label.querySelector("input"), output = label.querySelector("output");
  input.addEventListener("input", () => {
    const factor = 2 ** Number(input.value);
    output.textContent = `x ${factor.toPrecision(2)}`;
    for (const group of document.querySelectorAll(".vectors .scaled")) group.setAttribute("transform", `scale(${factor})`);
    for (const line of document.querySelectorAll(".vectors .arrow, .vectors .height")) {
      line.setAttribute("vector-effect", "non-scaling-stroke");
    }
  });
}

// the plan

async function tiePositions(ties) {
  const packed = Uint8Array.from(atob(ties.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer()), n = ties.count, grid = new Uint16Array(3 * n);
  for (let c = 0; c < 3; c++) for (let k = 0; k < n; k++) grid[c * n + k] = raw[2 * c * n + k] + 256 * raw[(2 * c + 1) * n + k];
  for (let k = 1; k < n; k++) grid[k] += grid[k - 1];  // X: steps from point to point, modulo 2^16
  return { grid, shade: raw.subarray(6 * n) };
}

const VIRIDIS = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];

function colour(shade) {
  const place = Math.max(0, shade - 1) / 254 * (VIRIDIS.length - 1), low = Math.min(Math.floor(place), VIRIDIS.length - 2);
  return VIRIDIS[low].map((c, k) => Math.round(c + (place - low) * (VIRIDIS[low + 1][k] - c)));
}

class Plan {
  constructor(holder, data, ties) {
    this.canvas = holder.querySelector("canvas");
    this.words = holder.querySelector(".hover");
    this.data = data;
    this.ties = ties;
    this.layers = { outlines: true, ties: true, sd: false };
    this.palette = Array.from({ length: 256 }, (_, k) => colour(k));
    this.offset = ties.grid ? data.ties.low.map((low, k) => low - data.origin[k]) : [0, 0, 0];
    this.listen(holder);
    this.reset();
  }

  reset() {
    const [x, y, z] = this.data.size;
    this.centre = [x / 2, y / 2, z / 2];
    this.turn = 0;
    this.tilt = 0;
    this.fit();
  }

  fit() {
    const box = this.canvas.getBoundingClientRect();
    this.ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(box.width * this.ratio));
    this.canvas.height = Math.max(1, Math.round(box.height * this.ratio));
    const [x, y, z] = this.data.size;
    const across = this.tilt ? Math.hypot(x, y) : x, up = this.tilt ? Math.hypot(x, y, z) : y;
    this.scale = 0.9 * Math.min(this.canvas.width / (across || 1), this.canvas.height / (up || 1));
    this.draw();
  }

  // parallel projection: turned about Z, then tilted about the horizontal axis of the picture
  matrix() {
    const c = Math.cos(this.turn), s = Math.sin(this.turn), t = Math.cos(this.tilt), h = Math.sin(this.tilt);
    return [[c, -s, 0], [s * t, c * t, h]].map((row) => row.map((value) => value * this.scale));
  }

  project(m, x, y, z) {
    const a = x - this.centre[0], b = y - this.centre[1], d = z - this.centre[2];
    return [this.canvas.width / 2 + m[0][0] * a + m[0][1] * b, this.canvas.height / 2 - m[1][0] * a - m[1][1] * b - m[1][2] * d];
  }

  draw() {
    if (this.waiting) return;
    this.waiting = requestAnimationFrame(() => {
      this.waiting = 0;
      this.paint();
    });
  }

  paint() {
    const pen = this.canvas.getContext("2d"), m = this.matrix(), style = getComputedStyle(root), r = this.ratio;
    const ink = (name) => style.getPropertyValue(name).trim();
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (this.layers.ties && this.ties.grid) this.paintTies(pen, m, ink("--tie"));
    pen.lineJoin = "round";
    if (this.layers.outlines) {
      pen.strokeStyle = ink("--inner");
      pen.fillStyle = ink("--area");
      pen.lineWidth = 0.7 * r;
      const shade = Math.min(1, 12 / this.data.outlines.length);  // many images lie above each other
      for (const corners of this.data.outlines) {
        pen.beginPath();
        for (let k = 0; k < corners.length; k += 2) pen.lineTo(...this.project(m, corners[k], corners[k + 1], this.data.level));
        pen.closePath();
        pen.globalAlpha = shade;
        pen.fill();
        pen.globalAlpha = Math.max(0.12, 0.4 * shade);
        pen.stroke();
        pen.globalAlpha = 1;
      }
    }
    this.places = [];
    const few = this.data.stations.length <= 400, size = (few ? 5 : 2.5) * r;
    pen.strokeStyle = ink("--ink");
    pen.lineWidth = 1.3 * r;
    for (const [x, y, z, name, row] of this.data.stations) {
      const [u, v] = this.project(m, x, y, z);
      pen.beginPath();
      pen.moveTo(u - size, v); pen.lineTo(u + size, v); pen.moveTo(u, v - size); pen.lineTo(u, v + size);
      pen.stroke();
      this.places.push([u, v, `image ${name}`, row, [x, y, z]]);
    }
    pen.fillStyle = ink("--paper");
    pen.lineWidth = 1.8 * r;
    for (const [x, y, z, name, row, check] of this.data.marks) {
      const [u, v] = this.project(m, x, y, z), s = 5 * r;
      pen.strokeStyle = ink(check ? "--outer" : "--inner");
      pen.beginPath();
      if (check) pen.rect(u - s, v - s, 2 * s, 2 * s);
      else { pen.moveTo(u, v - s); pen.lineTo(u + s, v + 0.8 * s); pen.lineTo(u - s, v + 0.8 * s); pen.closePath(); }
      pen.fill();
      pen.stroke();
      this.places.push([u, v, `${check ? "check" : "control"} point ${name}`, row, [x, y, z]]);
    }
    if (this.marked) {
      pen.strokeStyle = ink("--bad");
      pen.beginPath();
      pen.arc(...this.project(m, ...this.marked), 11 * r, 0, 2 * Math.PI);
      pen.stroke();
    }
    this.paintBar(pen, ink("--ink"));
  }

  paintTies(pen, m, plain) {
    const { width, height } = this.canvas, count = this.data.ties.count, { grid, shade } = this.ties;
    const picture = pen.createImageData(width, height), pixels = new Uint32Array(picture.data.buffer);
    const pack = ([a, b, c]) => 0xff000000 | (c << 16) | (b << 8) | a;
    const hex = plain.match(/[0-9a-f]{2}/gi).map((part) => parseInt(part, 16)), grey = pack(hex);
    const colours = this.palette.map(pack), step = this.data.ties.size.map((size) => size / 65535);
    const [ox, oy, oz] = this.offset.map((value, k) => value - this.centre[k]);
    const wide = count < 60000 ? Math.round(1.6 * this.ratio) : 1;
    for (let k = 0; k < count; k++) {
      const x = grid[k] * step[0] + ox, y = grid[count + k] * step[1] + oy, z = grid[2 * count + k] * step[2] + oz;
      const u = (width / 2 + m[0][0] * x + m[0][1] * y) | 0;
      const v = (height / 2 - m[1][0] * x - m[1][1] * y - m[1][2] * z) | 0;
      if (u < 0 || v < 0 || u >= width - wide || v >= height - wide) continue;
      const value = this.layers.sd && shade[k] ? colours[shade[k]] : grey;
      for (let a = 0; a < wide; a++) for (let b = 0; b < wide; b++) pixels[(v + a) * width + u + b] = value;
    }
    pen.putImageData(picture, 0, 0);
  }

  paintBar(pen, ink) {
    const r = this.ratio, power = 10 ** Math.floor(Math.log10(140 * r / this.scale));
    const length = [5, 2, 1].map((n) => n * power).find((n) => n * this.scale <= 140 * r) || power;
    const y = this.canvas.height - 14 * r, x = 14 * r, size = length * this.scale;
    pen.strokeStyle = pen.fillStyle = ink;
    pen.lineWidth = r;
    pen.font = `${12 * r}px system-ui, sans-serif`;
    pen.beginPath();
    pen.moveTo(x, y - 5 * r); pen.lineTo(x, y); pen.lineTo(x + size, y); pen.lineTo(x + size, y - 5 * r);
    pen.stroke();
    pen.fillText(`${+length.toPrecision(3)} ${this.data.unit}`, x + size + 8 * r, y);
    const u = this.canvas.width - 24 * r, v = this.canvas.height - 30 * r, c = Math.cos(this.turn), s = Math.sin(this.turn);
    pen.beginPath();
    for (const [a, b] of [[0, -16], [6, 8], [0, 3], [-6, 8]]) pen.lineTo(u + (c * a + s * b) * r, v + (c * b - s * a) * r);
    pen.closePath();
    pen.fill();
  }

  nearest(u, v) {
    let best = null, least = (12 * this.ratio) ** 2;
    for (const place of this.places || []) {
      const d = (place[0] - u) ** 2 + (place[1] - v) ** 2;
      if (d < least) [best, least] = [place, d];
    }
    if (best || !this.data.names || !this.layers.ties || !this.ties.grid) return best;
    const m = this.matrix(), { grid } = this.ties, { count, size } = this.data.ties;
    for (let k = 0; k < count; k++) {
      const xyz = [0, 1, 2].map((c) => grid[c * count + k] * size[c] / 65535 + this.offset[c]);
      const [a, b] = this.project(m, ...xyz), d = (a - u) ** 2 + (b - v) ** 2;
      if (d < least) [best, least] = [[a, b, `point ${this.data.names[k]}`, `points-${this.data.rows[k]}`, xyz], d];
    }
    return best;
  }

  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * this.ratio, (event.clientY - box.top) * this.ratio];
  }

  zoom(factor, u = this.canvas.width / 2, v = this.canvas.height / 2) {
    this.scale *= factor;
    this.pan((u - this.canvas.width / 2) * (1 - factor), (v - this.canvas.height / 2) * (1 - factor));
  }

  // moves what is seen by so many pixels
  pan(du, dv) {
    const c = Math.cos(this.turn), s = Math.sin(this.turn);
    const x = -du / this.scale, y = dv / this.scale / Math.max(0.2, Math.cos(this.tilt));
    this.centre[0] += c * x + s * y;
    this.centre[1] += c * y - s * x;
    this.draw();
  }

  describe(place) {
    if (!place) return "";
    const xyz = place[4].map((value, k) => (value + this.data.origin[k]).toFixed(2));
    return `${place[2]}: ${xyz.join(", ")} ${this.data.unit}`;
  }

  listen(holder) {
    let from = null, moved = 0;
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      moved = 0;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) {
        this.words.textContent = this.describe(this.nearest(...this.at(event)));
        return;
      }
      const du = event.clientX - from[0], dv = event.clientY - from[1];
      moved += Math.abs(du) + Math.abs(dv);
      from = [event.clientX, event.clientY];
      if (this.tilt) {
        this.turn += du / 150;
        this.tilt = Math.min(Math.PI / 2, Math.max(0.05, this.tilt - dv / 150));
        this.draw();
      } else this.pan(du * this.ratio, dv * this.ratio);
    });
    canvas.addEventListener("pointerup", (event) => {
      from = null;
      const place = moved < 4 ? this.nearest(...this.at(event)) : null;
      if (!place) return;
      this.marked = place[4];
      this.words.textContent = this.describe(place);
      show(place[3]);
      this.draw();
    });
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas && !event.ctrlKey) return;  // the page scrolls until the plan is clicked
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2, ...this.at(event));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }[event.key];
      if (by) { this.pan(...by); event.preventDefault(); }
      if (event.key === "+") this.zoom(1.3);
      if (event.key === "-") this.zoom(1 / 1.3);
    });
    const act = {
      in: () => this.zoom(1.4), out: () => this.zoom(1 / 1.4), reset: () => this.reset(),
      tilt: () => { this.tilt = this.tilt ? 0 : 1.0; this.turn = this.tilt ? 0.5 : 0; this.fit(); },
    };
    for (const button of holder.querySelectorAll("button")) {
      const name = button.dataset.do;
      if (name in this.layers) button.setAttribute("aria-pressed", String(this.layers[name]));
      button.addEventListener("click", () => {
        if (name in this.layers) {
          this.layers[name] = !this.layers[name];
          button.setAttribute("aria-pressed", String(this.layers[name]));
          this.draw();
        } else act[name]();
      });
    }
    document.addEventListener("theme", () => this.draw());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.fit()).observe(canvas);
  }
}

const scene = document.getElementById("scene");
if (scene) {
  const data = JSON.parse(scene.textContent);
  const start = (ties) => { root.plan = new Plan(document.getElementById("plan"), data, ties); };
  if (data.ties.count && "DecompressionStream" in window) tiePositions(data.ties).then(start, () => start({}));
  else start({});
}
