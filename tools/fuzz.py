"""Every reader on damaged files: `make fuzz MINUTES=10`, or `python -m tools.fuzz --minutes 10 --only trc`.

Each example of a device, the demo recording and a result of it are changed at random (bits, bytes, parts cut,
doubled or exchanged, digits) and read. Only an `UnoccludeError` may leave a reader, within `MOST_S` seconds.
What else comes is kept in out/fuzz/; `--again FILE` reads it once more. A finding becomes a test.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np

from smoother.errors import UnoccludeError
from smoother.io import read_recovery
from smoother.io.files import import_files, sort_files
from smoother.io.recording.read import open_recording, select_recordings
from smoother.io.registry import FileReader

ROOT = Path(__file__).parents[1]
#: A damaged example of some kilobytes is read or refused within this, s.
MOST_S = 20


class Late(BaseException):
    """More than `MOST_S`; no `Exception`, because readers turn those into refusals."""


def read(path: Path) -> None:
    """A file by every reader that takes it: as a recording and result, or as a device's export."""
    if path.suffix == ".mcap":
        for reader in (
            lambda: select_recordings(open_recording(path), alone=True),
            lambda: read_recovery(path),
        ):
            try:
                reader()
            except UnoccludeError:
                continue
        return
    reader = FileReader()
    skeletons, imus, _ = sort_files([path], reader)
    import_files(skeletons, imus, reader=reader)


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A file with one to four changes."""
    for _ in range(int(rng.integers(1, 5))):
        at, size = int(rng.integers(len(data) or 1)), int(rng.integers(1, 64))
        kind, before, part, after = int(rng.integers(5)), data[:at], data[at : at + size], data[at + size :]
        put = str(rng.choice(["nan", "-1", "1e309", "9" * 30, '"', ";", "\n"])).encode()
        middle = (bytes(each ^ 1 for each in part[:1]) + part[1:], rng.bytes(size), b"", 5 * part, put + part)
        data = (before if kind == 2 and size > 56 else before + middle[kind] + after) or b"\0"
    return data


def examples(folder: Path) -> dict[str, Path]:
    """A small file of every reader, by its name."""
    sys.path.insert(0, str(ROOT / "tests" / "helpers"))
    import device_files

    found = {}
    for key, write in device_files.EXAMPLES.items():
        found[key] = folder / (f"{key}.mcap" if key == "mcap" else key)
        write(found[key])
    found["recording"] = folder / "demo.mcap"
    found["recording"].write_bytes((ROOT / "data" / "demo.mcap").read_bytes())
    return found


def outcome(path: Path) -> str:
    """The traceback of a file that is neither read nor refused in a sentence; empty else."""
    signal.alarm(MOST_S)
    try:
        read(path)
    except UnoccludeError:
        pass
    except (Late, Exception):
        return traceback.format_exc()
    finally:
        signal.alarm(0)
    return ""


def main() -> int:
    """Damage and read until the time is over; 1 where anything was found."""
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--only", default="", help="readers whose name contains this")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--again", type=Path, help="read one file that was kept")
    options = parser.parse_args()

    def late(*_: object) -> None:
        raise Late(f"more than {MOST_S} s")

    signal.signal(signal.SIGALRM, late)
    if options.again:
        print(outcome(options.again) or "read, or refused in a sentence")
        return 0
    rng, tried, found = np.random.default_rng(options.seed), 0, 0
    end = time.monotonic() + 60 * options.minutes
    kept = ROOT / "out" / "fuzz"
    with tempfile.TemporaryDirectory() as name:
        sound = {k: v for k, v in examples(Path(name)).items() if options.only in k}
        while sound and time.monotonic() < end:
            for key, path in sound.items():
                damaged = Path(name) / f"damaged{path.suffix}"
                damaged.write_bytes(mutated(path.read_bytes(), rng))
                tried += 1
                if text := outcome(damaged):
                    found += 1
                    kept.mkdir(parents=True, exist_ok=True)
                    (kept / f"{key}-{tried}{path.suffix}").write_bytes(damaged.read_bytes())
                    print(f"{kept / key}-{tried}{path.suffix}\n{text}", flush=True)
    print(f"{tried} files by {len(sound)} readers, {found} findings")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
