"""All commands on one page. What a command needs is imported when it runs, so that help is quick."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import typer

from .lazy_commands import Place, lazy_group

_CSV_EXAMPLE = """Example: unocclude import csv session -o session.mcap

\b
session/recording.toml:
  [camera]
  frame = "kinect"            # or "optical", "zup"
  skeleton = "skeleton.csv"   # t_s, joint, x, y, z, state [, body]
  [imu.forearm_right]
  file = "imu.csv"            # t_s, ax, ay, az, gx, gy, gz [, mx, my, mz]
  accelerometer_unit = "g"    # or "m/s^2"
  gyroscope_unit = "deg/s"    # or "rad/s"
  [truth]                     # optional
  file = "truth.csv"          # t_s, x, y, z, qw, qx, qy, qz
"""


def _place(module: str, example: str, cls: str = "", has_settings: bool = False) -> Place:
    """A command with an example of its use below its help."""
    return Place(module, f"Example: unocclude {example}", cls, has_settings)


_COMMANDS = {
    "demo": _place("demo", "demo"),
    "info": _place("info", "info session.mcap"),
    "check": _place("check", "check session.mcap --json check.json"),
    "match": _place("match", "match session.mcap --json matches.json"),
    "repair": _place("repair", "repair broken.mcap -o whole.mcap --json lost.json"),
    "smooth": _place("smooth", "smooth session.mcap -o out.mcap --calibration arm.toml --report out.html"),
    "validate": _place(
        "validate", "validate out.mcap --truth trial.c3d --markers map.toml --calibration rig.toml"
    ),
    "compare": _place("compare", "compare session.mcap --truth trial.c3d --markers map.toml --report c.html"),
    "measures": _place("measures", "measures out.mcap --csv measures.csv --json measures.json"),
    "gaps": _place("gaps", "gaps session.mcap --lengths 0.5,1,2,3 --seed 1 --json gaps.json"),
    "export": _place("export", "export recovered.mcap --format trc -o recovered.trc"),
    "view": _place("view", "view recovered.mcap"),
    "batch": _place("batch", "batch sessions -o recovered --calibration arm.toml --report", "BatchCommand"),
    "progress": _place("sessions", "progress recovered --person p12 --report p12.html"),
    "live": _place(
        "live",
        "live --imu wrist --skeleton kinect --side right --record session.mcap --foxglove",
        "LiveCommand",
    ),
    "config": _place("config", "config > settings.toml"),
    "doctor": _place("doctor", "doctor"),
}
_IMPORTS = {
    "csv": Place("imports", _CSV_EXAMPLE),
    "files": _place(
        "import_files", "import files --skeleton azure.csv --imu forearm_right=dot.csv -o session.mcap"
    ),
    "formats": _place("import_files", "import formats"),
    "describe": _place("import_describe", "import describe sensor.csv > session/recording.toml"),
    "broad": _place("imports", "import broad 01_trial.mat -o trial.mcap"),
    "utd-mhad": _place("imports", "import utd-mhad a1_s1_t1_inertial.mat a1_s1_t1_skeleton.mat -o t.mcap"),
    "strap": _place("import_strap", "import strap session.mcap -o with_strap.mcap"),
}
_CALIBRATIONS = {
    "motion": _place("calibrate", "calibrate motion a.mcap b.mcap -o arm.toml"),
    "imu": _place("calibrate_imu", "calibrate imu poses.mcap -o arm.toml --report imu.html"),
    "magnetometer": _place("calibrate_imu", "calibrate magnetometer turning.mcap -o arm.toml"),
    "clock": _place(
        "calibrate_clock",
        "calibrate clock --sound beep.wav --event-time 12.3456 --broadcast times.csv",
    ),
    "panel": _place(
        "calibrate_panel",
        "calibrate panel --depth d.png --infrared i.png --markers m.csv --intrinsics k.toml"
        " --panel panel.toml -o cal.toml",
    ),
    "world": _place("calibrate_world", "calibrate world session.mcap --panel panel.toml -o cal.toml"),
    "forearm": _place(
        "calibrate_forearm", "calibrate forearm session.mcap -o arm.toml --report forearm.html"
    ),
}
_SIMULATIONS = {
    "arm": _place(
        "simulate", "simulate arm -o sim.mcap --preset realistic --repetitions 3 --seed 7", has_settings=True
    ),
    "clock": _place("simulate_clock", "simulate clock -o session --seed 7"),
    "imu": _place("simulate_sensor", "simulate imu -o poses.mcap --seed 7"),
    "magnetometer": _place("simulate_sensor", "simulate magnetometer -o turning.mcap --seed 7"),
    "panel": _place(
        "simulate_panel",
        "simulate panel -o session --poses 8 --seed 7 --mcap session.mcap",
        has_settings=True,
    ),
    "people": _place(
        "simulate_people",
        "simulate people -o people.mcap --people 2 --sensors 4 --seed 7",
        has_settings=True,
    ),
    "strap": _place("simulate_strap", "simulate strap -o session.mcap --seed 7"),
}


def _app(help_text: str, commands: Mapping[str, Place]) -> typer.Typer:
    return typer.Typer(
        help=help_text,
        cls=lazy_group(commands),
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )


app = _app("Recover an occluded arm from a depth camera's skeleton and one wrist IMU.", _COMMANDS)


def _version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        print(f"unocclude {__version__}")
        raise typer.Exit


@app.callback(epilog="Example: unocclude smooth session.mcap -o recovered.mcap --report report.html")
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Recover an occluded arm from a depth camera's skeleton and one wrist IMU."""


for _name, _help, _commands in (
    ("import", "Make a recording of other formats.", _IMPORTS),
    ("calibrate", "Measure once what does not change, and keep it in a calibration file.", _CALIBRATIONS),
    ("simulate", "Make a recording with truth.", _SIMULATIONS),
):
    app.add_typer(_app(_help, _commands), name=_name)
