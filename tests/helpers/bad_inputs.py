"""A folder of files that commands must refuse; a sound recording, a result and a study beside them."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from made_measures import made_measures, study_row, write_study
from results import made
from scipy.io import wavfile

from smoother.io import open_recording, write_recording, write_recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.rig import beep

_FLEXION = "elbow_flexion_range_deg"
_TEXTS = {
    "text.mcap": "this is not a recording\n" * 10,
    "broken.toml": "[camera\n",
    "unknown.toml": "[camera]\nfrob = 1\n",
    "range.toml": "[camera]\ncauchy = -1\n",
    "lever.toml": "[arm.right.lever_arm.elbow]\nposition_m = [30.0, -210.0, 0.0]\n",
    "no_sigma.toml": "[arm.right.lever_arm.elbow]\nposition_m = [0.03, -0.21, 0.0]\n",
    "words.csv": "t_s,ax,ay,az,gx,gy,gz\n0,1,2,9.8,0,0,0\n0.01,1,two,9.8,0,0,0\n",
    "lacks_z.csv": "t_s,ax,ay,gx,gy\n" + "".join(f"{0.01 * i:.2f},0,9.8,0,0\n" for i in range(200)),
    "lacks_gz.csv": "t_s,ax,ay,az,gx,gy\n0,0,0,9.8,0,0\n",
    "lens.toml": "fx = 1\nfy = 1\ncx = 1\ncy = 1\nwidth = 2\nheight = 2\n",
    "trials.csv": "name,start_s,end_s\nfirst,1,x\n",
    "markers.trc": "PathFileType\t4\t(X/Y/Z)\tmarkers.trc\n",
    "map.toml": "[markers]\nknee = ['KNE']\n",
    "sessions.csv": "file,person,date\na.mcap,p1,31.3.2026\n",
    "mdc.toml": "[mdc95]\nelbow_flexion_range_deg = 'much'\n",
    "plain/recording.toml": "[camera]\nframe = 'sideways'\nskeleton = 'skeleton.csv'\n",
    "half/recording.toml": "[camera]\nframe = 'kinect'\nskeleton = 'joints.csv'\n[imu.a]\nfile = 'a.csv'\n",
    "zero.toml": f"[mdc95]\n{_FLEXION} = 0\n",
    "broken.json": "{",
    "other.json": '{"all": {}}',
    "few.json": '{"reliability": []}',
    "empty.csv": "",
    "rows.csv": "t_s,x,y,z\n",
    "lacks_t.csv": "time,x,y,z\n0,1,2,3\n",
    "two.csv": "t_s,x,y,z\n0,1,2,3\n0.1,1,two,3\n",
    "poses_truth.toml": "mine",
    "first.txt": "a.csv\n",
    "second.txt": "p1/a.mcap\nb.mcap\tx\ty\n",
    "nothing.txt": "# nothing\n",
    "head.csv": "a,b\n1,2\n",
    "word.csv": "round,node,t_s\n1,a,1.0\n1,b,soon\n",
    "twice.csv": "round,node,t_s\n1,a,1.0\n1,a,2.0\n",
    "one.csv": "round,node,t_s\n1,a,1.0\n2,a,2.0\n",
    "apart.csv": "round,node,t_s\n1,a,1.0\n2,b,2.0\n",
    "sensors.toml": 'format = "unocclude calibration"\nversion = 1\nimu = [1]\n',
    "sigma.toml": "[sigma]\n",
    "factor.toml": "[sigma]\ngaps = [{length_s = 1.0, factor = -1.0, count = 3}]\n",
    "factors.toml": "[sigma]\ngaps = [" + "{length_s = 1, factor = 2, count = 3}, " * 2 + "]\n",
    "board.toml": "[panel]\nmarkers = [[0, 0], [0.2, 0], [0.5, 0], [0, 0.3]]\nextent = [[-1, -1], [1, 1]]\n",
    "cutoff.toml": "[smoothing]\ncutoff_hz = -6\n",
    "panel.toml": "[panel]\nmarkers = [[0, 0], [1, 0], [2, 0], [3, 0]]\nextent = [[-1, -1], [4, 1]]\n",
}
#: Tables of sessions of the study that `bad_inputs` makes.
_SESSIONS = (
    "",
    "file,who\np1/s0.mcap,p1\n",
    "file,person\np1/s0.mcap,p1\n",
    "file,person,session\n",
    "file,person,session\np1/s0.mcap,,1\n",
    "file,person,session\n,p1,1\n",
    "file,person,session\np1/s0.mcap,p1,\n",
    "file,person,session\nz.mcap,p1,1\n",
    "file,person,session\np1/s0.mcap,p1,1\np1/s0,p1,2\n",
    "file,person,date\np1/s0.mcap,p1,31.3.2026\n",
    "file,person,session\np1/s0.mcap,p1,1\np1/s1.mcap,p1,1\n",
    'file,person,session\n"p1/s0.mcap',
)
#: Calibrations that are none.
_HEAD = 'format = "unocclude calibration"\nversion = 1\n'
_CALIBRATIONS = (
    'format = "other"\nversion = 1\n',
    'format = "unocclude calibration"\n',
    _HEAD.replace("1", "1.0"),
    _HEAD.replace("1", "true"),
    _HEAD.replace("1", "2") + "arm = 3\n",
    _HEAD + "arm = 3\n",
    _HEAD + "typo = 3\n",
    _HEAD + "[arm.both]\n",
    _HEAD + "[arm]\nright = 3\n",
    _HEAD + "[arm.right]\nuper_arm_m = 0.3\n",
    _HEAD + "[arm.right]\nupper_arm_m = 0.3\n",
    _HEAD + "[arm.right]\nupper_arm_m = nan\nupper_arm_sigma_m = 1\n",
    _HEAD + "[arm.right]\nR_F_A = [1, 1, 0, 0]\n",
    _HEAD + "[arm.right]\nR_F_A = [1, 0, 0]\n",
    _HEAD + "[arm.right]\naccelerometer_bias = [1, 0, true]\n",
    _HEAD + "[arm.left.lever_arm.elbow]\nposition_m = [0, 0, 0]\nsigma_m = [1, 1, -1]\n",
    _HEAD + "[arm.right.lever_arm]\nelbow = 3\n",
    _HEAD + "[arm.right.lever_arm.knee]\nposition_m = [0, 0, 0]\nsigma_m = [1, 1, 1]\n",
)


def bad_inputs(folder: Path) -> None:
    """Write them; `good.mcap` is sound, `no_imu.mcap`, `no_joints.mcap` and `cut.mcap` are parts of it.

    `result.mcap` is a right arm recovered; in `study` are two persons with three sessions.
    """
    tables = {f"sessions{number}.csv": text for number, text in enumerate(_SESSIONS)}
    tables |= {f"calibration{number}.toml": text for number, text in enumerate(_CALIBRATIONS)}
    for name, text in (_TEXTS | tables).items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    (folder / "empty.mcap").touch()
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe.mcap")
    (folder / "folder").mkdir()
    for name in ("binary.toml", "binary.csv"):
        (folder / name).write_bytes(b"\xff\xfe\x00")
    cv2.imwrite(str(folder / "depth.png"), np.ones((2, 2), np.uint16))
    good = folder / "good.mcap"
    write_recording(simulate_arm(ArmSimulation(repetitions=1), 1).recording, good)
    file = open_recording(good)
    imus, file.imus = file.imus, []
    write_recording(file, folder / "no_imu.mcap")
    file.imus = [*imus, replace(imus[0], topic="/imu/base")]
    write_recording(file, folder / "two_imus.mcap")
    strap = simulate_arm(ArmSimulation(repetitions=1, strap=True), 1).recording
    hidden = strap.arm.hide(np.ones(len(strap.arm), bool), ("shoulder", "elbow", "wrist", "hand"))
    write_recording(replace(strap, arm=hidden), folder / "strap.mcap")
    angle = np.arange(len(imus[0].acc)) / 50.0
    file.imus = [replace(imus[0], mag=np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]))]
    write_recording(file, folder / "flat.mcap")
    file.imus, file.arms = imus, []
    write_recording(file, folder / "no_joints.mcap")
    write_recovery(made(), folder / "result.mcap")
    sound = beep(1)[0]
    wavfile.write(folder / "good.wav", 16000, (sound / np.abs(sound).max() * 30000).astype(np.int16))
    wavfile.write(folder / "silent.wav", 16000, np.zeros(16000, np.int16))
    (folder / "cut.wav").write_bytes((folder / "good.wav").read_bytes()[:30])
    sessions = [(person, n) for person in ("p1", "=p2") for n in range(3)]
    write_study(
        folder / "study",
        [
            study_row(f"{p}/s{n}.mcap", [made_measures(movements=0)], recorded_day=50.0 + n)
            for p, n in sessions
        ],
    )
    for name, row in (("flat", "a.mcap"), ("bare", "p/a.mcap"), ("spoilt", "p/a.mcap")):
        write_study(folder / name, [study_row(row, [made_measures()] if name == "flat" else None)])
    (folder / "spoilt" / "results" / "rows-2.parquet").write_bytes(b"cut off")
    (folder / "cut.mcap").write_bytes(good.read_bytes()[:2000])
