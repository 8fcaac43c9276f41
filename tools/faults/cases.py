"""The faults of `tools.faults`: sound files, and what is done to them."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "helpers"))  # examples of devices' files

from smoother.cli.run import run
from smoother.io.recording.write import as_file, write_recording
from smoother.recording import JOINTS, JointState, Recording
from tools.faults import file_faults, value_faults
from tools.faults import surroundings as around
from tools.faults.surroundings import Motion

Rng = np.random.Generator
Change = Callable[[bytes, Rng], bytes]
#: A recording of the matrix: seconds, and this many variants of each fault.
DURATION_S = 8


@dataclass(frozen=True)
class Case:
    """One damaged file and the command that reads it.

    Attributes
    ----------
    family, fault, name : str
        Kind of file, what was done to it, and which variant.
    base : str
        Folder of the sound inputs, and the command.
    kind : str
        What is compared: `info`, `smooth` or `figures`.
    command : tuple of str
        Words; IN/ is the folder of the inputs, OUT/ that of the outputs.
    change : callable
        Damages the inputs in a folder.
    compares : tuple of str
        Keys of the figures.
    runs : callable, optional
        Runs the case in a folder by itself, instead of `command` on changed inputs: from the folder and
        what compares motions (`tools.faults.other_motion`) to the end and its sentence.
    cpu_s : int, s
        Processor time that it may take where that is more than usual, else 0.
    """

    family: str
    fault: str
    name: str
    base: str
    kind: str
    command: tuple[str, ...]
    change: Callable[[Path], None]
    compares: tuple[str, ...] = ()
    runs: Callable[[Path, Motion], around.End] | None = None
    cpu_s: int = 0

    def sound(self, shop: Workshop) -> Case:
        """The same command on the sound files."""
        words = tuple(
            word.replace("IN/", f"{shop.folder / self.base.partition(' ')[0]}/") for word in self.command
        )
        return replace(self, command=words)

    def make(self, shop: Workshop, folder: Path) -> None:
        """Put damaged inputs into a folder."""
        shutil.copytree(shop.folder / self.base.partition(" ")[0], folder / "in")
        self.change(folder / "in")

    def arguments(self, folder: Path) -> list[str]:
        """Words of the command."""
        return [word.replace("IN/", f"{folder}/in/").replace("OUT/", f"{folder}/") for word in self.command]


class Workshop:
    """Makes the sound files.

    Parameters
    ----------
    folder : Path
        Where they are stored.
    seed : int
        Of the faults.
    """

    def __init__(self, folder: Path, seed: int):
        self.folder, self.seed = folder, seed
        first = folder / "ours"
        first.mkdir()
        words = f"simulate arm -o {first}/rec.mcap --calibration-out {first}/cal.toml --seed 3 --mocap"
        _quiet([*words.split(), "--protocol", "random", "--duration-s", str(DURATION_S)])
        for name, way in file_faults.WAYS.items():
            (folder / name).mkdir()
            shutil.copy(first / "cal.toml", folder / name)
            (folder / name / "rec.mcap").write_bytes(file_faults.wrapped(first / "rec.mcap", way))
        (folder / "result").mkdir()
        for path in first.iterdir():
            shutil.copy(path, folder / "result")
        words = f"smooth {first}/rec.mcap -o {folder}/result/out.mcap --calibration {first}/cal.toml"
        _quiet([*words.split(), "--processes", "1"])

    @cached_property
    def with_long(self) -> Path:
        """The folder, with a recording that is long enough for temporary files."""
        words = ["simulate", "arm", "-o", f"{self.folder}/long.mcap", "--seed", "4", "--protocol", "random"]
        _quiet([*words, "--duration-s", "240", "--set", "imu_rate_hz=200"])
        return self.folder

    @cached_property
    def with_study(self) -> Path:
        """The folder, with three recordings and what `batch` made of them."""
        (self.folder / "studied").mkdir()
        for seed in range(3):
            words = f"simulate arm -o {self.folder}/studied/{seed}.mcap --seed {seed} --duration-s 6"
            _quiet([*words.split(), "--protocol", "random"])
        _quiet(["batch", f"{self.folder}/studied", "-o", f"{self.folder}/study", "--processes", "1"])
        return self.folder

    def rng(self, *words: object) -> Rng:
        """Numbers of a case, whatever cases come before it."""
        return np.random.default_rng([self.seed, *" ".join(map(str, words)).encode()])


def _quiet(words: list[str]) -> None:
    """A command that must work, without what it prints."""
    from contextlib import redirect_stdout
    from io import StringIO

    with redirect_stdout(StringIO()):
        if run(words):
            raise RuntimeError(f"{words} failed")


SMOOTH = (
    *("smooth", "IN/rec.mcap", "-o", "OUT/out.mcap", "--calibration", "IN/cal.toml"),
    *("--processes", "1", "--draws", "0"),
)


def all_cases(shop: Workshop) -> list[Case]:
    """Every case, in the order of the table."""
    return [
        *_containers(shop),
        *_values(shop),
        *_texts(shop),
        *_markers(shop),
        *_devices(shop),
        *_calibrations(shop),
        *_results(shop),
        *_surroundings(shop),
    ]


def _bytes(path: str, change: Change, rng: Rng) -> Callable[[Path], None]:
    """A change of one file's bytes."""

    def damage(folder: Path) -> None:
        file = folder / path
        file.write_bytes(change(file.read_bytes(), rng))

    return damage


def _containers(shop: Workshop) -> Iterator[Case]:
    """Containers of every way to write them; every fifth is recovered, the others are listed."""
    number = 0
    for way in file_faults.WAYS:
        for fault, change in file_faults.CONTAINER.items():
            for variant in range(6):
                number += 1
                smooth = number % 5 == 0
                yield Case(
                    f"MCAP, {way}",
                    fault,
                    f"{fault} {variant}",
                    f"{way} {'smooth' if smooth else 'info'}",
                    "smooth" if smooth else "info",
                    SMOOTH if smooth else ("info", "IN/rec.mcap"),
                    _bytes("rec.mcap", change, shop.rng(way, fault, variant)),
                )


def _values(shop: Workshop) -> Iterator[Case]:
    """Sound containers with values, stamps, rates and names that are not."""
    for fault, (change, variants) in value_faults.RECORDING.items():
        for variant in range(variants):
            yield Case(
                "recording",
                fault,
                f"{fault} {variant}",
                "ours smooth",
                "smooth",
                SMOOTH,
                partial(_rewrite, change, shop.rng(fault, variant)),
                cpu_s=value_faults.LONG.get(fault, 0),
            )
    for fault, by_message in value_faults.MESSAGES.items():
        for variant in range(8):
            yield Case(
                "messages",
                fault,
                f"{fault} {variant}",
                "ours smooth",
                "smooth",
                SMOOTH,
                _bytes(
                    "rec.mcap", partial(file_faults.rewritten, change=by_message), shop.rng(fault, variant)
                ),
            )


def _rewrite(change: Callable[[Recording, Rng], Recording], rng: Rng, folder: Path) -> None:
    from smoother.io import read_recording

    with np.errstate(all="ignore"):
        file = as_file(change(read_recording(folder / "rec.mcap"), rng))
        write_recording(file, folder / "rec.mcap", force=True)


def _texts(shop: Workshop) -> Iterator[Case]:
    """Folders of plain files."""
    folder = shop.folder / "csv"
    folder.mkdir()
    for name, text in plain_folder(shop.folder / "ours" / "rec.mcap").items():
        (folder / name).write_text(text)
    command = tuple(["import", "csv", "IN/", "-o", "OUT/new.mcap"])
    for file in ("imu.csv", "skeleton.csv", "recording.toml"):
        for fault, change in file_faults.TEXT.items():
            for variant in range(4):
                damage = _bytes(file, change, shop.rng(file, fault, variant))
                yield Case(f"CSV, {file}", fault, f"{fault} {variant}", "csv import", "info", command, damage)


def plain_folder(path: Path) -> dict[str, str]:
    """A recording as plain files."""
    from smoother.io import read_recording

    recording = read_recording(path)
    imu = ["t_s,ax,ay,az,gx,gy,gz"]
    for t, *values in np.column_stack([recording.imu.t_s, recording.imu.acc, recording.imu.gyro]).tolist():
        imu.append(",".join([f"{t:.6f}", *(f"{value:.6f}" for value in values)]))
    rows = ["t_s,joint,x,y,z,state"]
    for frame, t in enumerate(recording.arm.t_s.tolist()):
        for column, joint in enumerate(JOINTS):
            state = JointState(int(recording.arm.state[frame, column])).name.lower()
            place = ["", "", ""]
            if state != "not_tracked":
                place = [f"{value:.5f}" for value in recording.arm.position[frame, column].tolist()]
            rows.append(",".join([f"{t:.6f}", f"{joint}_right", *place, state]))
    about = '[camera]\nframe = "kinect"\nskeleton = "skeleton.csv"\n[imu.forearm_right]\nfile = "imu.csv"\n'
    return {"imu.csv": "\n".join(imu) + "\n", "skeleton.csv": "\n".join(rows) + "\n", "recording.toml": about}


def _markers(shop: Workshop) -> Iterator[Case]:
    """Motion capture as truth."""
    for ending, faults in (("trc", file_faults.TEXT), ("c3d", file_faults.C3D)):
        words = f"validate IN/out.mcap --truth IN/rec.{ending} --markers IN/rec_markers.toml"
        command = (*words.split(), "--calibration", "IN/cal.toml")
        for fault, change in faults.items():
            for variant in range(6 if ending == "trc" else 12):
                damage = _bytes(f"rec.{ending}", change, shop.rng(ending, fault, variant))
                name = f"{fault} {variant}"
                base = f"result {ending}"
                yield Case(ending.upper(), fault, name, base, "figures", command, damage, ("all",))


def _devices(shop: Workshop) -> Iterator[Case]:
    """Exports of devices, with the other stream sound."""
    import device_files

    partner = {"imu": ("shimmer", device_files.IMUS), "skeleton": ("kinect-v2", device_files.SKELETONS)}
    for kind, table in (("imu", device_files.IMUS), ("skeleton", device_files.SKELETONS)):
        other = "skeleton" if kind == "imu" else "imu"
        for key in table:
            folder = shop.folder / f"device_{kind}_{key}"
            folder.mkdir()
            try:
                table[key](folder / kind)
                name, others = partner[other]
                others[name if name in others else next(iter(others))](folder / other)
            except (OSError, ImportError):
                continue
            command = tuple(
                [
                    "import",
                    "files",
                    "--skeleton",
                    "IN/skeleton",
                    "--imu",
                    "forearm_right=IN/imu",
                    "-o",
                    "OUT/new.mcap",
                ]
            )
            check = [word.replace("IN/", f"{folder}/").replace("OUT/", f"{folder}/") for word in command]
            try:
                from contextlib import redirect_stderr
                from io import StringIO

                with redirect_stderr(StringIO()):
                    _quiet(check)
            except RuntimeError:
                continue  # a pair that does not overlap
            (folder / "new.mcap").unlink()
            is_text = b"\0" not in (folder / kind).read_bytes()[:4000]
            faults = file_faults.TEXT if is_text else file_faults.BINARY
            for fault, change in faults.items():
                for variant in range(2):
                    damage = _bytes(kind, change, shop.rng(key, fault, variant))
                    base = f"device_{kind}_{key} import"
                    name = f"{key}, {fault} {variant}"
                    yield Case(f"device, {kind}", fault, name, base, "info", command, damage)


def _calibrations(shop: Workshop) -> Iterator[Case]:
    for fault, change in value_faults.CALIBRATION.items():
        for variant in range(4):
            damage = _bytes("cal.toml", change, shop.rng("calibration", fault, variant))
            yield Case("calibration", fault, f"{fault} {variant}", "ours smooth", "smooth", SMOOTH, damage)


def _results(shop: Workshop) -> Iterator[Case]:
    words = "validate IN/out.mcap --truth IN/rec.mcap"
    for fault, change in file_faults.CONTAINER.items():
        for variant in range(4):
            damage = _bytes("out.mcap", change, shop.rng("result", fault, variant))
            name = f"{fault} {variant}"
            yield Case(
                "result", fault, name, "result validate", "figures", tuple(words.split()), damage, ("all",)
            )
    for fault, change in value_faults.METADATA.items():
        for variant in range(6):
            by_record = partial(file_faults.other_metadata, change=change)
            damage = _bytes("out.mcap", by_record, shop.rng("metadata", fault, variant))
            name = f"{fault} {variant}"
            yield Case(
                "result", fault, name, "result validate", "figures", tuple(words.split()), damage, ("all",)
            )


def _surroundings(shop: Workshop) -> Iterator[Case]:
    """What surrounds a command: disks, folders, memory, other programs, a study that was damaged."""

    def case(fault: str, name: str, work: Callable[[Path, Motion], around.End]) -> Case:
        return Case("surroundings", fault, name, "none", "runs", (), lambda folder: None, runs=work)

    def on(name: str) -> tuple[Path, list[str]]:
        place = shop.with_study if name == "batch" else shop.folder
        return place, around.words_of(place)[name]

    def in_place(name: str, work: Callable[..., around.End], what: object) -> Case:
        def runs(folder: Path, motion: Motion) -> around.End:
            place, words = on(name)
            return work(what, words, place, folder, motion)

        return case(FAULTS[work], f"{name}, {what}", runs)

    if around.can_mount():
        for name in around.words_of(shop.folder):
            for size in ("4k", "100k", "700k"):
                yield in_place(name, around.full_output, size)
            yield in_place(name, around.read_only, "output")
        for what in ("temporary", "input"):
            yield in_place("smooth", around.read_only, what)
        for size in ("4k", "1m", "3m", "64m"):
            yield case(
                "disk for temporary files full",
                f"smooth, {size}",
                lambda folder, motion, size=size: around.full_temporary(  # type: ignore[misc]
                    size, shop.with_long, folder, motion
                ),
            )
    for name in ("smooth", "batch"):
        for megabytes in (150, 250, 350, 450):
            yield in_place(name, around.limited_memory, megabytes)
    for name in ("smooth", "smooth with report", "repair", "export", "batch"):
        yield in_place(name, around.two_at_once, "twice")
    for name in ("smooth", "batch"):
        for after_s in (1.5, 3.0, 4.5):
            yield in_place(name, around.killed_worker, after_s)
    for fault, damage in around.LEDGER.items():
        for variant in range(2):
            rng = shop.rng("ledger", fault, variant)
            yield case(
                "ledger of a study damaged",
                f"{fault} {variant}",
                lambda folder, motion, damage=damage, rng=rng: around.damaged_study(  # type: ignore[misc]
                    damage, rng, shop.with_study, folder, motion
                ),
            )


FAULTS: dict[Callable[..., around.End], str] = {
    around.full_output: "disk for outputs full",
    around.read_only: "a folder that cannot be written to",
    around.limited_memory: "little memory",
    around.two_at_once: "two runs on one output",
    around.killed_worker: "a worker killed",
}
