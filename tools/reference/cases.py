"""The cases: commands of `unocclude` in groups, each in a folder of its own. To add one is to add a line.

A line is a command without the program's name, run where the lines above it ran. Its name in the reference is
the line itself, so that a changed line is a new case. `PROJECT/` is the project's folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tools.reference import inputs
from tools.reference.running import Group, Step

_DEMO = """
smooth PROJECT/data/demo.mcap -o out.mcap --report out.html --json out.json --processes 1
info PROJECT/data/demo.mcap --json info.json
check PROJECT/data/demo.mcap --json check.json --processes 1
measures out.mcap --csv measures.csv --json measures.json --report measures.html
validate out.mcap --truth PROJECT/data/demo.mcap --json validate.json --report validate.html
export out.mcap --format csv -o out.csv --json csv.json
export out.mcap --format trc -o out.trc
export out.mcap --format trc -o camera.trc --frame camera --rate 50 --origin shoulder
export out.mcap --format mot -o out.mot
export out.mcap --format c3d -o out.c3d
export out.mcap --format parquet -o out.parquet
export out.mcap --format sto -o out.sto
export out.mcap --format bids -o bids --subject p1 --recording PROJECT/data/demo.mcap
methods out.mcap -o methods.tex --json methods.json
repair PROJECT/data/demo.mcap -o whole.mcap --json repair.json
cut PROJECT/data/demo.mcap --from 10 --to 25 -o part.mcap --json cut.json
info out.mcap --json result.json
smooth PROJECT/data/demo.mcap -o out.mcap --processes 1
smooth PROJECT/data/demo.mcap -o two.mcap --calibration PROJECT/data/demo_calibration.toml \
--processes 2 --strict
"""
_DEMO_GAPS = """
demo -o demo --processes 1 --json demo.json
gaps PROJECT/data/demo.mcap --lengths 0.5,1,2 --seed 1 --json gaps.json --report gaps.html \
--keep-in cal.toml --processes 1
"""
_METHODS = """
simulate arm -o a.mcap --calibration-out cal.toml --preset realistic --protocol random \
--duration-s 15 --seed 6 --mocap
compare a.mcap --calibration cal.toml --methods all --report c.html --json c.json --processes 1
smooth a.mcap -o rts.mcap --method rts --calibration cal.toml --processes 1
smooth a.mcap -o hold.mcap --method hold --processes 1
smooth a.mcap -o out.mcap --calibration cal.toml --processes 1
validate out.mcap --truth a.c3d --markers a_markers.toml --calibration cal.toml --json c3d.json \
--report c3d.html
validate out.mcap --truth a.trc --markers a_markers.toml --calibration cal.toml --json trc.json
validate out.mcap --truth a.mcap --align --json aligned.json
"""
#: What is done to each simulated recording; the options of `simulate arm` by the group's name.
_SIMULATED = {
    "clean": "--preset clean --protocol random --duration-s 15 --seed 1",
    "white": "--preset white --protocol random --duration-s 20 --seed 2 --set imu_rate_hz=100",
    "white, protocol behind": "--preset white --protocol behind --repetitions 1 --seed 3",
    "realistic, left": "--preset realistic --protocol random --duration-s 20 --seed 4 --side left"
    " --set camera_frame=optical",
    "azure": "--preset azure --protocol random --duration-s 25 --seed 5",
    "strap tracked": "--preset white --protocol random --duration-s 15 --seed 6 --set strap=true",
    "inferred joints, outliers": "--preset realistic --protocol random --duration-s 18 --seed 7"
    " --set occluded_state=inferred --set outliers=0.02 --set frozen_gaps=0.3",
    "arm at rest": "--preset white --protocol hang --duration-s 15 --seed 8",
    "upper-arm IMU": "--preset realistic --protocol random --duration-s 20 --seed 9 --imus wrist,upper-arm",
    "trunk IMU": "--preset realistic --protocol random --duration-s 20 --seed 10"
    " --imus wrist,upper-arm,trunk",
    "one camera without depth": "--preset realistic --protocol random --duration-s 30 --seed 20 --rgb all",
    "both arms": "--preset realistic --protocol random --duration-s 16 --seed 11 --arms both",
}
_EACH = """
simulate arm -o a.mcap --calibration-out cal.toml {options} --json a.json
info a.mcap --json info.json
smooth a.mcap -o out.mcap --report out.html --json out.json --processes 1
smooth a.mcap -o given.mcap --calibration cal.toml --json given.json --processes 1
validate out.mcap --truth a.mcap --json validate.json
measures out.mcap --json measures.json
export out.mcap --format csv -o out.csv
"""
_DRAWS = """
simulate arm -o a.mcap --preset white --protocol random --duration-s 15 --seed 12
smooth a.mcap -o out.mcap --draws 8 --seed 3 --json out.json --report out.html --processes 1
export out.mcap --format parquet --draws -o draws.parquet
measures out.mcap --json measures.json --csv measures.csv --report measures.html
"""
_WRONG = """
simulate arm -o a.mcap --calibration-out cal.toml --preset realistic --protocol random \
--duration-s 15 --seed 13
smooth a.mcap -o mirrored.mcap --mirror x --json mirrored.json --processes 1
smooth a.mcap -o swapped.mcap --swap elbow,wrist --json swapped.json --processes 1 --strict
check a.mcap --negate gyroscope --json check.json --processes 1
smooth a.mcap -o a.mcap
smooth none.mcap -o out.mcap
smooth a.mcap -o out.mcap --max-sigma-m 0.01 --clock-offset 0.02 --clock-sigma 0.005 --processes 1
smooth a.mcap -o none.mcap --anatomy martian
export a.mcap --format trc -o a.trc
simulate arm -o b.mcap --duration-s -3
"""
_LIVE = """
simulate arm -o a.mcap --calibration-out cal.toml --preset realistic --protocol random \
--duration-s 15 --seed 14
live --replay a.mcap --speed 0 --calibration cal.toml --record live.mcap --json live.json
"""
_LIVE_BOTH = """
simulate arm -o a.mcap --arms both --imus wrist,upper-arm --preset realistic --protocol random \
--duration-s 12 --seed 14
live --replay a.mcap --arms both --speed 0 --record live.mcap --json live.json
"""
_LIVE_COMPARED = """
simulate arm -o a.mcap --calibration-out cal.toml --preset realistic --protocol random \
--duration-s 15 --seed 14
compare a.mcap --live --methods graph --calibration cal.toml --json live.json --processes 1
"""
_STUDY = """
simulate arm -o sessions/p1/a.mcap --protocol random --duration-s 8 --seed 15
simulate arm -o sessions/p1/b.mcap --protocol random --duration-s 8 --seed 16
batch sessions -o study --processes 1 --measures --draws 20 --json study.json
progress study --json progress.json --csv progress.csv --report progress.html
"""
_MATCH = """
simulate people -o people.mcap --people 2 --sensors 4 --protocol random --duration-s 15 --seed 17 \
--json people.json
match people.mcap --method all --json matches.json
"""
_MOTION = """
simulate arm -o a.mcap --protocol random --duration-s 20 --seed 18
simulate arm -o b.mcap --protocol random --duration-s 15 --seed 19
calibrate motion a.mcap -o arm.toml --json arm.json --processes 1
calibrate motion a.mcap -o again.toml --known arm.toml --processes 1
calibrate motion a.mcap b.mcap -o two.toml --processes 1
simulate arm -o held.mcap --preset realistic --protocol behind --repetitions 1 --seed 4
calibrate forearm held.mcap -o arm.toml --radius-m 0.035 --strap-to-wrist-m 0.05 --report f.html \
--json f.json --processes 1
"""
_SENSOR = """
simulate imu -o poses.mcap --seed 20 --json poses.json
calibrate imu poses.mcap -o imu.toml --report imu.html --json imu.json
simulate magnetometer -o turning.mcap --seed 21 --json turning.json
calibrate magnetometer turning.mcap -o imu.toml --report mag.html --json mag.json
"""
_CLOCK = """
simulate clock -o session --seed 22 --motion-s 20 --json session.json
calibrate clock --sound session/beep.wav --event-time 17.5962500 \
--broadcast session/times.csv -o clock.toml --json clock.json --report clock.html
calibrate clock --motion session/session.mcap -o clock.toml --json motion.json --processes 1
"""
_PANEL = """
simulate panel -o panel --mcap panel.mcap --poses 3 --seed 21 --camera-tilt-deg 30 --tilt-deg 15,38 \
--json s.json
calibrate world panel.mcap --panel panel/panel.toml -o world.toml --report world.html --json world.json
"""
_PANEL_STILL = """
simulate panel -o still --poses 2 --seed 5
calibrate panel --depth still/pose_01_depth.png --infrared still/pose_01_infrared.png \
--markers still/pose_01_markers.csv --depth still/pose_02_depth.png \
--infrared still/pose_02_infrared.png --markers still/pose_02_markers.csv \
--intrinsics still/intrinsics.toml --panel still/panel.toml -o cal.toml --report panel.html \
--json panel.json
"""
_STRAP = """
simulate strap -o session.mcap --duration-s 8 --seed 23 --json session.json
import strap session.mcap -o with_strap.mcap --radius-m 0.032 --report strap.html --json strap.json \
--processes 1
"""
_PLAIN = """
import csv session -o session.mcap --json session.json
info session.mcap --json info.json
import describe session/imu.csv --json described.json
import csv nothing -o nothing.mcap
import utd-mhad inertial.mat skeleton.mat -o utd.mcap
import formats --json formats.json
config --json config.json
"""


def help_steps(folder: Path) -> Iterator[Step]:
    """`--help` of the program, of its groups of commands and of every command, as the program names them."""
    from smoother.cli import app

    yield Step(("--help",), folder)
    yield Step(("--version",), folder)
    for group, commands in (
        ("", app._COMMANDS),
        ("import", app._IMPORTS),
        ("calibrate", app._CALIBRATIONS),
        ("simulate", app._SIMULATIONS),
    ):
        if group:
            yield Step((group, "--help"), folder)
        for command in commands:
            yield Step((*filter(None, [group]), command, "--help"), folder)


#: Those that take longest first.
GROUPS: tuple[Group, ...] = (
    Group("study", _STUDY, inputs=inputs.sessions_folder),
    Group("demo", _DEMO),
    Group("methods", _METHODS),
    *(Group(name, _EACH.format(options=options)) for name, options in _SIMULATED.items()),
    Group("live replay", _LIVE),
    Group("live with both arms", _LIVE_BOTH),
    Group("live compared", _LIVE_COMPARED),
    Group("demo, gaps", _DEMO_GAPS),
    Group("wrong set-up", _WRONG),
    Group("draws", _DRAWS),
    Group("calibrate world", _PANEL),
    Group("calibrate panel", _PANEL_STILL),
    Group("calibrate motion", _MOTION),
    Group("strap", _STRAP),
    Group("calibrate clock", _CLOCK),
    Group("calibrate imu", _SENSOR),
    Group("match", _MATCH),
    Group("devices", steps=inputs.devices),
    Group("plain files", _PLAIN, inputs=inputs.plain_files),
    Group("help", steps=help_steps),
)
