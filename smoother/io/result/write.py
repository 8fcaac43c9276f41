"""A recovery to an MCAP file that Foxglove and Rerun show as it is."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import chain

from ...errors import UnoccludeError
from ...result import Recovery, arm_tags
from ...runtime.outputs import check_output, writing
from ..mcap.container import Container
from ..mcap.merge import Output, time_batches
from ..recording.json_messages import Passthrough
from ..recording.read import METADATA, RESULT_PREFIX, open_recording
from ..recording.write import CAMERA
from .drawing import common_down
from .metadata import recovery_values
from .streams import AXES, RecoveryStreams

RESULT = "unocclude.result"


def write_recovery(
    recoveries: Recovery | Sequence[Recovery],
    path: str | os.PathLike[str],
    *,
    source: str | os.PathLike[str] | None = None,
    force: bool = False,
    passthrough_images: bool = False,
) -> tuple[str, ...]:
    """Write the recovered motion of one arm, or of several, to an MCAP file.

    Topics: `/unocclude/forearm` (Odometry: pose of the IMU in the camera frame, velocity in its own
    axes; an answer without orientation has body_frame_id = frame_id, one without position is left out),
    `/unocclude/skeleton` (joints with covariance at every IMU sample), `/unocclude/arm` and
    `/unocclude/arm_camera` (drawn after and before, at the camera's rate, orange where occluded, dark red
    where the answer is not to be trusted), `/unocclude/beads` (PointCloud along the bones),
    `/unocclude/gaps` (Event, with `trusted` and `reasons` in its metadata), `/unocclude/log` (Log: the
    gaps), `/unocclude/joints` (JointStates: elbow_flexion, rad, 0 = straight), `/unocclude/tf`
    (FrameTransforms: camera to forearm IMU, and the level `world` to the camera), `/unocclude/camera`
    (the camera's joints on the IMU's clock), `/unocclude/residuals`, and where motions were drawn
    `/unocclude/draws`. With several arms each topic ends
    in the arm's side, with several people in `body_N/SIDE` (`result.arm_tags`). The metadata record
    `unocclude.result` contains all else as JSON. `read_recovery` gives everything back. The same input
    gives the same bytes.

    Parameters
    ----------
    recoveries : Recovery or sequence of Recovery
        One arm's recovery, or several of one recording.
    path : path-like
        The file to write.
    source : path-like, optional
        The recording; its topics of motion are copied as they are.
    force : bool
        Overwrite a file that exists.
    passthrough_images : bool
        Copy all other topics as well: images in any form (they show patients), sound, texts, positions on
        Earth and whatever is not known.

    Returns
    -------
    notes : tuple of str
        Sentences for the user: which topics were left out.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, it is the recording itself, or it cannot be written.
    """
    results = [recoveries] if isinstance(recoveries, Recovery) else list(recoveries)
    check_output(path, force)
    if source is not None and os.path.exists(path) and os.path.samefile(source, path):
        raise UnoccludeError(f"{path} is the recording itself; give another name to write to.")
    carrying = Passthrough(passthrough_images)
    frames: dict[str, str] = {}
    shift = 0
    level_down = None
    if source is not None:
        file = open_recording(source, only={recovery.arm.name for recovery in results})
        frames = {arm.topic: arm.frame_id for arm in file.arms if arm.frame_id}
        level_down = file.level_down
        shift = file.imus[0].log_shift_ns if file.imus else 0
        # A recorder's delay is not a reason to move; a sensor that counts from its own start is.
        shift = shift if abs(shift) > 1_000_000_000 else 0
    with writing(path, force) as temporary, Output(temporary) as output:
        streams = []
        down = common_down(results, level_down)
        for tag, recovery in zip(arm_tags(results), results, strict=True):
            suffix = "" if len(results) == 1 else f"/{tag}"
            output.metadata(RESULT + suffix, recovery_values(recovery, _version()))
            frame_id = frames.get(recovery.arm.name, CAMERA)
            streams.append(RecoveryStreams(output, recovery, suffix, frame_id, shift, down))
        if source is not None:
            container = Container(source)
            output.interleave(
                container.chunks(lambda topic: not topic.name.startswith(RESULT_PREFIX) and carrying(topic))
            )
        for batch in time_batches([axis for each in streams for axis in each.axes()]):
            rows = [batch.rows[AXES * i : AXES * (i + 1)] for i in range(len(streams))]
            outgoing = [each.batch(*mine) for each, mine in zip(streams, rows, strict=True)]
            output.write(list(chain.from_iterable(outgoing)), batch.until_ns)
        if source is not None and METADATA in container.metadata:  # wherever in the source it stands
            output.metadata(METADATA, container.metadata[METADATA])
    return (carrying.sentence,) if carrying.sentence else ()


def _version() -> str:
    try:
        return version("unocclude")
    except PackageNotFoundError:
        return "unknown"
