"""`unocclude simulate strap`: an arm's recording with images of its dark strap."""

from __future__ import annotations

from typing import Annotated

import typer

from .options import Force, Json, Output, Seed
from .output import check_mcap, check_outputs, print_table, say_command, say_written, write_json, write_truth


def strap(
    output: Output,
    duration_s: Annotated[
        float, typer.Option("--duration-s", min=8.0, max=120.0, help="Length of the recording, s.")
    ] = 20.0,
    every: Annotated[
        int, typer.Option("--every", min=1, max=60, help="Images at every so many of the camera's frames.")
    ] = 5,
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Simulate an arm with images of its strap, for `import strap`.

    Beside FILE lies FILE_truth.toml: where the strap sits. FILE holds the true motion of the IMU.
    """
    from ..io.media.strap_writing import write_strap_recording
    from ..simulation import ArmSimulation, simulate_arm
    from ..simulation.strap_session import COLOUR, DEPTH, DEPTH_LATER_S, strap_images, strap_radius_m
    from .progress import progress_bar

    truth_file = output.with_name(f"{output.stem}_truth.toml")
    check_mcap(output)
    check_outputs(force, [output, truth_file, json_file])
    simulated = simulate_arm(ArmSimulation(protocol="random", duration_s=duration_s), seed)
    recording, measures = simulated.recording, simulated.parameters
    times = recording.arm.t_s[::every]
    with progress_bar("drawing the arm") as progress:
        images = []
        for pair in strap_images(simulated, times, seed):
            images.append(pair)
            progress(len(images) / len(times), "drawing the arm")
    write_strap_recording(output, recording, images, times, (COLOUR, DEPTH), DEPTH_LATER_S, force=force)
    radius_m = strap_radius_m(simulated)
    truth = {
        "strap": {
            "radius_m": radius_m,
            "from_elbow_m": float(measures["forearm_m"] - measures["strap_to_wrist_m"]),
            "along": float(1.0 - measures["strap_to_wrist_m"] / measures["forearm_m"]),
        }
    }
    write_truth(truth_file, truth, force)
    write_json(json_file, {"seed": seed, "images": len(images), "truth": truth}, force)
    rows = [
        ("images, colour and depth", len(images)),
        ("forearm's core to the IMU, mm", f"{1e3 * radius_m:.1f}"),
        ("elbow to the strap, mm", f"{1e3 * truth['strap']['from_elbow_m']:.1f}"),
        ("the same in parts of the forearm", f"{truth['strap']['along']:.2f}"),
    ]
    print_table(output.name, ("what", "value"), rows)
    say_written(output, truth_file, json_file)
    say_command("import", "strap", output, "-o", "with_strap.mcap", "--radius-m", f"{radius_m:.3f}")
