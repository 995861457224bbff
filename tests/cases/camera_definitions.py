"""The camera models of the format, written out once more in numpy, with values to try them on."""

import numpy as np

PHOTO_VECTOR = (210.0, -170.0, -737.5)

_E = (2e-4, -1e-4, 1e-5, -2e-5, 3e-5, 1e-5, 2e-7, -1e-7, 3e-7, 2e-7, 1e-9, -2e-9)
GRUEN_ORDER = [(0, 2), (0, 3), (1, 2), (2, 1), (3, 0), (0, 4), (1, 3), (2, 2), (3, 1), (4, 0)]
GRUEN_ORDER += [(1, 4), (2, 3), (3, 2), (4, 1), (2, 4), (3, 3), (4, 2), (3, 4), (4, 3), (4, 4)]
_DEGREES = (1, 1, 2, 2, *(i + j for i, j in GRUEN_ORDER for _ in "xy"))
_G = tuple((-1) ** k * (1 + 0.1 * k) * 0.02 * 92.0**-degree for k, degree in enumerate(_DEGREES))
_PX = (4655.7, 1250.0, 840.5)
INTERIORS = {
    "none": (153.2, 0.012, -0.031, 1.0, 1.0),
    "brown": (28.4, 1250.0, 840.5, 1.3e-4, -2.1e-7, 3e-10, 2.5e-5, -1.7e-5, 3e-4, -2e-4, 0.0061, -1.0),
    "brown-affine-last": (28.4, 1250.0, 840.5, 1.3e-4, -2.1e-7, 3e-10, 2.5e-5, -1.7e-5, 3e-4, -2e-4, 0.0061, -1.0),
    "brown-scale-first": (28.4, 1250.0, 840.5, 1.3e-4, -2.1e-7, 3e-10, 2.5e-5, -1.7e-5, 3e-4, 0.0061, -1.0),
    "brown-forward": (28.4, 1250.0, 840.5, 1.3e-4, -2.1e-7, 3e-10, 2.5e-5, -1.7e-5, 0.0061, -1.0),
    "aicon": (28.4, 0.02, -0.13, -1.3e-4, 2.1e-7, -3e-10, 2.5e-5, -1.7e-5, 3e-4, -2e-4, 9.5, 1.0, 1.0),
    "metashape": (4655.7, 1250.0, 840.5, -0.11, 0.05, -0.013, 2.5e-4, -1.7e-4, 1.9, -0.8, 0.004, -1.0),
    "bal": (1520.4, -0.21, 0.035),
    "ebner": (153.2, 0.012, -0.031, 1e-6, -2e-11, 3e-15, 1e-6, -2e-6, *_E, 92.0, 1.0, 1.0),
    "gruen": (153.2, 0.012, -0.031, 1e-6, -2e-11, 3e-15, 1e-6, -2e-6, *_G, 92.0, 1.0, 1.0),
    "opencv-rational": (*_PX, -0.11, 0.05, -0.013, 0.02, -0.01, 0.003, 2.5e-4, -1.7e-4, 1.9, -0.8, -1.0),
    "fisheye": (*_PX, -0.11, 0.05, -0.013, 0.02, 2.5e-4, -1.7e-4, 1e-4, -2e-4, 1.9, -0.8, -1.0),
    "fisheye-624": (
        *(*_PX, -0.11, 0.05, -0.013, 0.02, -0.01, 0.003, 2.5e-4, -1.7e-4),
        *(1e-4, -2e-4, 3e-4, 1e-5, 1.9, -0.8, -1.0),
    ),
    "fov": (*_PX, 0.93, 1.9, -0.8, -1.0),
    "division": (*_PX, -0.12, 1.9, -0.8, -1.0),
    "eucm": (*_PX, 0.53, 1.1, 1.9, -0.8, -1.0),
}
MEASURED = {
    **dict.fromkeys(INTERIORS, (2480.3, 1920.8)),
    **dict.fromkeys(("none", "ebner", "gruen"), (43.7, -35.2)),
    "aicon": (8.1, -6.7),
    "bal": (440.1, -350.9),
}


def computed(model, interior, photo_vector, measured) -> np.ndarray:
    """The residual of a camera model, for numbers."""
    return np.array(model.residual(tuple(interior), tuple(photo_vector), tuple(measured)))


def brown(x, y, k1, k2, k3, p1, p2):
    """D(x, y) of the format."""
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return (
        x * radial + p1 * (r2 + 2 * x**2) + 2 * p2 * x * y,
        y * radial + p2 * (r2 + 2 * y**2) + 2 * p1 * x * y,
    )


def ebner(x, y, e, b):
    """Ebner's twelve corrections as they are usually printed."""
    X, Y = x**2 - 2 * b**2 / 3, y**2 - 2 * b**2 / 3
    dx = e[0] * x + e[1] * y - 2 * e[2] * X + e[3] * x * y + e[4] * Y + e[6] * x * Y + e[8] * y * X + e[10] * X * Y
    dy = -e[0] * y + e[1] * x + e[2] * x * y - 2 * e[3] * Y + e[5] * X + e[7] * y * X + e[9] * x * Y + e[11] * X * Y
    return dx, dy


def monic_orthogonal(points, b):
    """Coefficients, highest power first, of the monic polynomials orthogonal on `points` places from -b to b."""
    places, found = np.linspace(-b, b, points), []
    for degree in range(points):
        power = np.poly1d([1.0] + [0.0] * degree)
        for lower in found:
            power = power - lower * (places**degree @ lower(places)) / (lower(places) @ lower(places))
        found.append(power)
    return found


def gruen(x, y, g, b):
    """Gruen's 44: products of polynomials orthogonalised on the grid; the tilts' partners by their sums over it."""
    T = monic_orthogonal(5, b)
    grid = np.linspace(-b, b, 5)
    ratio = np.sum(grid**2) ** 2 / (5 * np.sum(T[2](grid) ** 2))
    dx = g[0] * x + g[1] * y - ratio * g[2] * T[2](x) + g[3] * x * y
    dy = -g[0] * y + g[1] * x + g[2] * x * y - ratio * g[3] * T[2](y)
    for k, (i, j) in enumerate(GRUEN_ORDER):
        dx = dx + g[4 + 2 * k] * T[i](x) * T[j](y)
        dy = dy + g[5 + 2 * k] * T[j](x) * T[i](y)
    return dx, dy


LENSES = ("opencv-rational", "fisheye", "fisheye-624", "fov", "division", "eucm")


def lens(name, interior, x, y, measured):
    """Models of strongly distorting lenses, x right, y down; y up in the residual."""
    f, u0, v0, *d, b1, b2, _ = interior
    r = np.hypot(x, y)
    if name.startswith("fisheye"):
        x, y = x * np.arctan(r) / r, y * np.arctan(r) / r
        r = np.arctan(r)
    if name == "opencv-rational":
        factor = (1 + d[0] * r**2 + d[1] * r**4 + d[2] * r**6) / (1 + d[3] * r**2 + d[4] * r**4 + d[5] * r**6)
        dx, dy = brown(x, y, 0, 0, 0, *d[6:8])
        x, y = x * factor + dx - x, y * factor + dy - y
    elif name == "fisheye":
        dx, dy = brown(x, y, *d[:3], *d[4:6])
        x, y = dx + x * d[3] * r**8 + d[6] * r**2, dy + y * d[3] * r**8 + d[7] * r**2
    elif name == "fisheye-624":
        factor = 1 + sum(k * r ** (2 * n) for n, k in enumerate(d[:6], 1))
        x, y = x * factor, y * factor
        w = x**2 + y**2
        dx, dy = brown(x, y, 0, 0, 0, *d[6:8])
        x, y = dx + d[8] * w + d[9] * w**2, dy + d[10] * w + d[11] * w**2
    else:
        factor = {
            "fov": lambda: np.arctan(2 * r * np.tan(d[0] / 2)) / (r * d[0]),
            "division": lambda: 2 / (1 + np.sqrt(1 - 4 * d[0] * r**2)),
            "eucm": lambda: 1 / (d[0] * np.sqrt(d[1] * r**2 + 1) + 1 - d[0]),
        }[name]()
        x, y = x * factor, y * factor
    return u0 + (f + b1) * x + b2 * y - measured[0], -(v0 + f * y - measured[1])


def definition(name, interior, photo_vector, measured):
    """The residual by the FORMAT of the block folder, line by line; y up."""
    px, py, pz = photo_vector
    u, v = measured
    if name == "bal":
        f, k1, k2 = interior
        x, y = -px / pz, -py / pz
        r2 = x**2 + y**2
        return f * (1 + k1 * r2 + k2 * r2**2) * x - u, f * (1 + k1 * r2 + k2 * r2**2) * y - v
    if name in LENSES:
        return lens(name, interior, -px / pz, py / pz, measured)
    if name == "metashape":
        f, u0, v0, *d, b1, b2, k4, _ = interior
        x, y = brown(-px / pz, py / pz, *d)
        r2 = (px**2 + py**2) / pz**2
        x, y = x - px / pz * k4 * r2**4, y + py / pz * k4 * r2**4
        return u0 + x * f + x * b1 + y * b2 - u, -(v0 + y * f - v)
    c, u0, v0, *d, s, y_axis = interior
    xs, ys = -c * px / pz, -c * py / pz
    x, y = (u - u0) * s, y_axis * (v - v0) * s
    if name == "brown":
        x, y = brown((1 + d[5]) * x + d[6] * y, y, *d[:5])
    elif name == "brown-affine-last":
        x, y = brown(x, y, *d[:5])
        x, y = (1 + d[5]) * x + d[6] * y, y
    elif name == "brown-scale-first":
        x, y = brown(((1 + d[5]) * u - u0) * s, y, *d[:5])
    elif name == "brown-forward":
        x_d, y_d = brown(xs, ys, *d)
        return u0 + x_d / s - u, -(v0 - y_d / s - v)
    elif name == "aicon":
        a1, a2, a3, b1, b2, c1, c2, r0 = d
        r2 = xs**2 + ys**2
        dr = a1 * (r2 - r0**2) + a2 * (r2**2 - r0**4) + a3 * (r2**3 - r0**6)
        x = u0 + xs + xs * dr + b1 * (r2 + 2 * xs**2) + 2 * b2 * xs * ys + c1 * xs + c2 * ys
        return x - u, v0 + ys + ys * dr + b2 * (r2 + 2 * ys**2) + 2 * b1 * xs * ys - v
    elif name in ("ebner", "gruen"):
        x, y = brown(x, y, *d[:5])
        dx, dy = {"ebner": ebner, "gruen": gruen}[name](x, y, d[5:-1], d[-1])
        x, y = x + dx, y + dy
    return (xs - x) / s, (ys - y) / s
