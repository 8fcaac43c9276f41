"""All commands on one page. What a command needs is imported when it runs, so that help is quick."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer
from typer.core import TyperCommand

from . import (
    batch,
    calibrate,
    calibrate_clock,
    calibrate_forearm,
    calibrate_imu,
    calibrate_panel,
    calibrate_world,
    check,
    compare,
    config,
    demo,
    doctor,
    export,
    gaps,
    import_describe,
    import_files,
    import_strap,
    imports,
    info,
    live,
    match,
    measures,
    repair,
    sessions,
    simulate,
    smooth,
    validate,
    view,
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


def _add(
    group: typer.Typer, command: Callable[..., None], example: str, cls: type[TyperCommand] | None = None
) -> None:
    """Add a command under its function's name, with an example of its use below its help."""
    name = command.__name__.replace("_", "-")
    group.command(name, cls=cls, epilog=f"Example: unocclude {example}")(command)


_add(app, demo.demo, "demo")
_add(app, info.info, "info session.mcap")
_add(app, check.check, "check session.mcap --json check.json")
_add(app, match.match, "match session.mcap --json matches.json")
_add(app, repair.repair, "repair broken.mcap -o whole.mcap --json lost.json")
_add(app, smooth.smooth, "smooth session.mcap -o out.mcap --calibration arm.toml --report out.html")
_add(app, validate.validate, "validate out.mcap --truth trial.c3d --markers map.toml --calibration rig.toml")
_add(app, compare.compare, "compare session.mcap --truth trial.c3d --markers map.toml --report c.html")
_add(app, measures.measures, "measures out.mcap --csv measures.csv --json measures.json")
_add(app, gaps.gaps, "gaps session.mcap --lengths 0.5,1,2,3 --seed 1 --json gaps.json")
_add(app, export.export, "export recovered.mcap --format trc -o recovered.trc")
_add(app, view.view, "view recovered.mcap")
_add(app, batch.batch, "batch sessions -o recovered --calibration arm.toml --report", batch.BatchCommand)
_add(app, sessions.progress, "progress recovered --person p12 --report p12.html")
_add(
    app,
    live.live,
    "live --imu wrist --skeleton kinect --side right --record session.mcap --foxglove",
    live.LiveCommand,
)
_add(app, config.config, "config > settings.toml")
_add(app, doctor.doctor, "doctor")

_imports = _app("Make a recording of other formats.")
_imports.command("csv", epilog=_CSV_EXAMPLE)(imports.csv)
_add(
    _imports,
    import_files.files,
    "import files --skeleton azure.csv --imu forearm_right=dot.csv -o session.mcap",
)
_add(_imports, import_files.formats, "import formats")
_add(_imports, import_describe.describe, "import describe sensor.csv > session/recording.toml")
_add(_imports, imports.broad, "import broad 01_trial.mat -o trial.mcap")
_add(_imports, imports.utd_mhad, "import utd-mhad a1_s1_t1_inertial.mat a1_s1_t1_skeleton.mat -o t.mcap")
_add(_imports, import_strap.strap, "import strap session.mcap -o with_strap.mcap")
app.add_typer(_imports, name="import")

_calibrate = _app("Measure once what does not change, and keep it in a calibration file.")
_add(_calibrate, calibrate.motion, "calibrate motion a.mcap b.mcap -o arm.toml")
_add(_calibrate, calibrate_imu.imu, "calibrate imu poses.mcap -o arm.toml --report imu.html")
_add(_calibrate, calibrate_imu.magnetometer, "calibrate magnetometer turning.mcap -o arm.toml")
_add(
    _calibrate,
    calibrate_clock.clock,
    "calibrate clock --sound beep.wav --event-time 12.3456 --broadcast times.csv",
)
_add(
    _calibrate,
    calibrate_panel.panel,
    "calibrate panel --depth d.png --infrared i.png --markers m.csv --intrinsics k.toml --panel panel.toml"
    " -o cal.toml",
)
_add(_calibrate, calibrate_world.world, "calibrate world session.mcap --panel panel.toml -o cal.toml")
_add(
    _calibrate, calibrate_forearm.forearm, "calibrate forearm session.mcap -o arm.toml --report forearm.html"
)
app.add_typer(_calibrate, name="calibrate")

_simulate = _app("Make a recording with truth.", cls=simulate.SimulateGroup)


@_simulate.callback()
def _simulate_root() -> None:
    """Make a recording with truth."""


app.add_typer(_simulate, name="simulate")
