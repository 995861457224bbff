"""Replaces a folder of results again and again, killed or interrupted at every step in turn: FOLDER, inside or beside.

Prints how many steps there are; an assertion tells what was left wrong.
"""

import json
import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

from jaxbundle.report import result_folder

STEPS = {
    os: ("mkdir", "rename", "replace", "unlink", "rmdir", "fsync", "open", "listdir"),
    result_folder: ("_exchange",),
}
KILLED = 9
OLD, NEW = ["images.csv", "check_points.csv", "report.json", "report.txt"], ["images.csv", "parameters.csv"]
NEW += ["report.json", "report.txt"]


def write(target: Path, names: list[str], content: str) -> None:
    """A report whose files all have the same content."""
    result_folder.require_writable(target, names, 1000)
    with result_folder.replaced(target, names) as place:
        for name in names:
            text = json.dumps({"content": content, "files": names}) if name == "report.json" else content
            (place / name).write_text(text)


def with_end_at(step: int, end: Callable[[], None]) -> None:
    """Patches the system's functions: before the call of this number the end comes."""
    count = 0

    def patched(function: Callable) -> Callable:
        def call(*args, **options):
            nonlocal count
            count += 1
            if count == step:
                end()
            return function(*args, **options)

        return call

    for module, names in STEPS.items():
        for name in names:
            setattr(module, name, patched(getattr(module, name)))


def in_a_process(work: Callable[[], None]) -> int:
    """Exit code of a child that does the work."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        work()
    except KeyboardInterrupt:
        os._exit(KILLED)
    except BaseException as error:
        os.write(2, f"{type(error).__name__}: {error}\n".encode())
        os._exit(1)
    os._exit(0)


def content(target: Path) -> str | None:
    """What the whole report says; None where there is no report.json."""
    if not (target / "report.json").exists():
        return None
    report = json.loads((target / "report.json").read_text())
    for name in report["files"]:
        text = (target / name).read_text()
        assert report["content"] in text, f"{name} does not belong to report.json"
    return report["content"]


def others(target: Path) -> bool:
    """Whether what no adjustment wrote is there."""
    return (target / "mine.txt").exists() and (target / "photos" / "1.jpg").exists()


def interrupt() -> None:
    raise KeyboardInterrupt


def main(home: Path, inside: bool) -> None:
    steps = 0
    for end in (lambda: os._exit(KILLED), interrupt):
        step, code = 0, KILLED
        while code == KILLED:
            step += 1
            target = home / f"{step}-{end is interrupt}" / "results"
            write(target, OLD, "old")
            (target / "photos").mkdir()
            (target / "photos" / "1.jpg").touch()
            (target / "mine.txt").touch()
            os.chdir(target if inside else home)

            def work(step=step, end=end, target=target) -> None:
                with_end_at(step, end)
                write(target, NEW, "new")

            code = in_a_process(work)
            assert code in (0, KILLED), (step, code)
            found = content(target)
            assert found in ("old", "new") or (inside and found is None), (step, found)
            assert not inside or others(target)
            assert in_a_process(lambda target=target: write(target, NEW, "newer")) == 0, (step, "is refused for ever")
            assert content(target) == "newer" and others(target), step
            left = {path.name for path in target.iterdir()} | {path.name for path in target.parent.iterdir()}
            assert left == {*NEW, "photos", "mine.txt", "results"}, (step, left)
        steps += step
    print(steps)


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # of JAX about fork: nothing of it runs here
    os.fsync = lambda _: None  # a process is killed here, the power stays on
    main(Path(sys.argv[1]), sys.argv[2] == "inside")
