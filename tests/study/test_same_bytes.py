"""The same input gives the same file, on any number of processes."""

from __future__ import annotations

from smoother.cli.run import run
from smoother.io import write_recording
from smoother.runtime import pool
from smoother.simulation import ArmSimulation, simulate_arm


def test_any_number_of_processes_any_time(tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "WORTH_FRAMES", 0)  # also a short recording goes to processes
    settings = ArmSimulation.preset(
        "white", protocol="random", duration_s=25.0, occlusion_lengths_s=(1.0,), occlusion_every_s=6.0
    )
    source = tmp_path / "rec.mcap"
    write_recording(simulate_arm(settings, 3).recording, source)
    for name, processes in (("one", 1), ("again", 1), ("two", 2)):
        out = tmp_path / f"{name}.mcap"
        assert run(["smooth", str(source), "-o", str(out), "--processes", str(processes)]) == 0
    one = (tmp_path / "one.mcap").read_bytes()
    assert one == (tmp_path / "again.mcap").read_bytes()
    assert one == (tmp_path / "two.mcap").read_bytes()
