"""All commands on one page. What a command needs is imported when it runs, so that help is quick."""

from __future__ import annotations

from typing import Annotated

import typer

from . import (
    batch,
    calibrate,
    calibrate_clock,
    calibrate_forearm,
    calibrate_imu,
    calibrate_panel,
    calibrate_world,
    compare,
    config,
    demo,
    doctor,
    export,
    gaps,
    import_strap,
    imports,
    info,
    simulate,
    smooth,
    validate,
)

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


def _app(help_text: str, **options: object) -> typer.Typer:
    return typer.Typer(
        help=help_text,
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
        **options,  # type: ignore[arg-type]
    )


app = _app("Recover an occluded arm from a depth camera's skeleton and one wrist IMU.")


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


app.command("demo", epilog="Example: unocclude demo")(demo.demo)
app.command("info", epilog="Example: unocclude info session.mcap")(info.info)
app.command(
    "smooth",
    epilog="Example: unocclude smooth session.mcap -o out.mcap --calibration arm.toml --report out.html",
)(smooth.smooth)
app.command(
    "validate",
    epilog="Example: unocclude validate out.mcap --truth trial.c3d --markers map.toml --calibration rig.toml",
)(validate.validate)
app.command(
    "compare",
    epilog="Example: unocclude compare session.mcap --truth trial.c3d --markers map.toml --report c.html",
)(compare.compare)
app.command(
    "gaps", epilog="Example: unocclude gaps session.mcap --lengths 0.5,1,2,3 --seed 1 --json gaps.json"
)(gaps.gaps)
app.command("export", epilog="Example: unocclude export recovered.mcap --format trc -o recovered.trc")(
    export.export
)
app.command(
    "batch",
    cls=batch.BatchCommand,
    epilog="Example: unocclude batch sessions -o recovered --calibration arm.toml --report",
)(batch.batch)
app.command("config", epilog="Example: unocclude config > settings.toml")(config.config)
app.command("doctor", epilog="Example: unocclude doctor")(doctor.doctor)

_imports = _app("Make a recording of other formats.")
_imports.command("csv", epilog=_CSV_EXAMPLE)(imports.csv)
_imports.command("broad", epilog="Example: unocclude import broad 01_trial.mat -o trial.mcap")(imports.broad)
_imports.command(
    "utd-mhad",
    epilog="Example: unocclude import utd-mhad a1_s1_t1_inertial.mat a1_s1_t1_skeleton.mat -o t.mcap",
)(imports.utd_mhad)
_imports.command("strap", epilog="Example: unocclude import strap session.mcap -o with_strap.mcap")(
    import_strap.strap
)
app.add_typer(_imports, name="import")

_calibrate = _app("Measure once what does not change, and keep it in a calibration file.")


@_calibrate.callback()
def _calibrate_root() -> None:
    """Measure once what does not change, and keep it in a calibration file."""


_calibrate.command("motion", epilog="Example: unocclude calibrate motion a.mcap b.mcap -o arm.toml")(
    calibrate.motion
)
_calibrate.command("imu", epilog="Example: unocclude calibrate imu poses.mcap -o arm.toml --report imu.html")(
    calibrate_imu.imu
)
_calibrate.command(
    "magnetometer", epilog="Example: unocclude calibrate magnetometer turning.mcap -o arm.toml"
)(calibrate_imu.magnetometer)
_calibrate.command(
    "clock",
    epilog="Example: unocclude calibrate clock --sound beep.wav --event-time 12.3456 --broadcast times.csv",
)(calibrate_clock.clock)
_calibrate.command(
    "panel",
    epilog="Example: unocclude calibrate panel --depth d.png --infrared i.png --markers m.csv"
    " --intrinsics k.toml --panel panel.toml -o cal.toml",
)(calibrate_panel.panel)
_calibrate.command(
    "world", epilog="Example: unocclude calibrate world session.mcap --panel panel.toml -o cal.toml"
)(calibrate_world.world)
_calibrate.command(
    "forearm", epilog="Example: unocclude calibrate forearm session.mcap -o arm.toml --report forearm.html"
)(calibrate_forearm.forearm)
app.add_typer(_calibrate, name="calibrate")

_simulate = _app("Make a recording with truth.", cls=simulate.SimulateGroup)


@_simulate.callback()
def _simulate_root() -> None:
    """Make a recording with truth."""


app.add_typer(_simulate, name="simulate")
