"""`unocclude simulate strap`: an arm's recording with images of its dark strap."""

from __future__ import annotations

from typing import Annotated

import typer

from .option_groups import with_groups
from .output import print_table, say_command
from .simulated_file import SimulatedFile


@with_groups
def strap(
    to: SimulatedFile,
    duration_s: Annotated[
        float, typer.Option("--duration-s", min=8.0, max=120.0, help="Length of the recording, s.")
    ] = 20.0,
    every: Annotated[
        int, typer.Option("--every", min=1, max=60, help="Images at every so many of the camera's frames.")
    ] = 5,
) -> None:
    """Simulate an arm with images of its strap, for `import strap`.

    Beside FILE lies FILE_truth.toml: where the strap sits. FILE holds the true motion of the IMU.
    """
    from ..io.media.strap import write_strap_recording
    from ..simulation import ArmSimulation, simulate_arm
    from ..simulation.strap import COLOUR, DEPTH, DEPTH_LATER_S, strap_images, strap_radius_m
    from .progress import progress_bar

    to.check()
    simulated = simulate_arm(ArmSimulation(protocol="random", duration_s=duration_s), to.seed)
    recording, measures = simulated.recording, simulated.parameters
    times = recording.arm.t_s[::every]
    with progress_bar("drawing the arm") as progress:
        images = []
        for pair in strap_images(simulated, times, to.seed):
            images.append(pair)
            progress(len(images) / len(times), "drawing the arm")
    write_strap_recording(to.output, recording, images, times, (COLOUR, DEPTH), DEPTH_LATER_S, force=to.force)
    radius_m = strap_radius_m(simulated)
    truth = {
        "strap": {
            "radius_m": radius_m,
            "from_elbow_m": float(measures["forearm_m"] - measures["strap_to_wrist_m"]),
            "along": float(1.0 - measures["strap_to_wrist_m"] / measures["forearm_m"]),
        }
    }
    to.write_truth(truth, images=len(images))
    rows = [
        ("images, colour and depth", len(images)),
        ("forearm's core to the IMU, mm", f"{1e3 * radius_m:.1f}"),
        ("elbow to the strap, mm", f"{1e3 * truth['strap']['from_elbow_m']:.1f}"),
        ("the same in parts of the forearm", f"{truth['strap']['along']:.2f}"),
    ]
    print_table(to.output.name, ("what", "value"), rows)
    to.say_written()
    say_command("import", "strap", to.output, "-o", "with_strap.mcap", "--radius-m", f"{radius_m:.3f}")
