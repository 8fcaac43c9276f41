"""What a study of many recordings costs: `python tools/study_cost.py`.

Recovers simulated recordings of one and of several minutes as `unocclude batch` does, in this process, and
counts processor time, bytes and memory; takes the results of many invented recordings for the size of a row.
Prints the costs of a million recordings from these.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from smoother.io import write_recording
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.study.folder import Row
from smoother.study.inputs import config_hash, text_hash
from smoother.study.job import Job, StudySettings, run_job
from smoother.study.ledger import MOST_ROWS, Ledger
from smoother.study.run import study_folder


def recovered(folder: Path, minutes: float, seed: int) -> tuple[Row, float]:
    """The row of a recording of this length, and the processor time that it took, s."""
    arm = ArmSimulation.preset(
        "white",
        protocol="random",
        duration_s=60.0 * minutes,
        imu_rate_hz=80.0,
        frame_rate_hz=30.0,
        occlusion_lengths_s=(2.0,),
        occlusion_every_s=10.0,
    )
    source = folder / f"{minutes:g}.mcap"
    write_recording(simulate_arm(arm, seed).recording, source)
    study, settings = study_folder(folder / "out"), StudySettings()
    hashed = config_hash(settings.config, settings.choice)
    job = Job(source.name, str(source), str(study.path), study.open(), settings, hashed)
    began = time.process_time()
    row = run_job(job)
    if row["status"] != "done":
        raise SystemExit(row["error"])
    return row, time.process_time() - began


def row_costs(folder: Path, row: Row, count: int) -> tuple[float, float]:
    """Bytes of a row among the results, and processor time to take one up again, s."""
    study = study_folder(folder / "rows")
    study.open()
    ledger, random = Ledger(study), np.random.default_rng(0)
    numbers = [name for name, value in row.items() if isinstance(value, float)]
    for number in range(count):
        name = f"participant{number // 20:05d}/session{number % 20:02d}.mcap"
        draws = dict(zip(numbers, random.normal(size=len(numbers)).tolist(), strict=True))
        hashes = {"input_hash": text_hash(name), "output_hash": text_hash(name, "out")}
        ledger.add(
            {**row, **draws, **hashes, "id": text_hash(name)[:32], "recording": name, "output": name}
            | {"input": f"/data/study/{name}", "finished": datetime.now(UTC).isoformat()}
        )
        if (number + 1) % MOST_ROWS == 0:
            ledger.flush()
    ledger.flush()
    size = sum(path.stat().st_size for path in study.results.iterdir())
    began = time.process_time()
    Ledger(study)
    return size / count, (time.process_time() - began) / count


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=6.0, help="length of the study's recordings")
    parser.add_argument("--recordings", type=int, default=1_000_000)
    parser.add_argument("--rows", type=int, default=20_000, help="invented rows to measure the results with")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        recovered(Path(name), 0.5, 0)  # loads all libraries
        short_s = recovered(Path(name), 1.0, 0)[1]
        row, spent_s = recovered(Path(name), options.minutes, 0)
        row_bytes, again_s = row_costs(Path(name), row, options.rows)
    count, minutes, hours = options.recordings, options.minutes, options.recordings * spent_s / 3600
    read, written = (count * row[name] / 1e12 for name in ("input_bytes", "output_bytes"))
    print(f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
    for length, spent in ((1.0, short_s), (minutes, spent_s)):
        print(f"{length:g} minutes: {spent:.2f} s of a processor, {60 * length / spent:.0f} times real time")
    print(f"recording: {row['input_bytes'] / minutes / 1e6:.2f} MB per minute")
    print(f"output: {row['output_bytes'] / minutes / 1e6:.2f} MB per minute")
    print(f"row of results: {row_bytes:.0f} bytes; taken up again in {1e6 * again_s:.0f} us")
    print(f"{count:,} recordings of {minutes:g} minutes ({count * minutes / 60:,.0f} h):")
    print(
        f"  processor hours: {hours:,.0f}; {hours / 32:,.0f} h on 32 processors, {hours / 1000:.1f} on 1,000"
    )
    print(f"  bytes: {read:.1f} TB of recordings, {written:.1f} TB of outputs")
    print(f"  results: {count * row_bytes / 1e9:.2f} GB, taken up again in {count * again_s:.0f} s")


if __name__ == "__main__":
    main()
