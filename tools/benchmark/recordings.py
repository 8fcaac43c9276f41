"""The recordings that are measured on: simulated, written as MCAP, their truth kept beside."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from smoother.io import write_recording
from smoother.io.wire.schemas import message_class, schema_data
from smoother.recording import Recording, Truth
from smoother.simulation import ArmSimulation, simulate_arm

IMU_RATE_HZ, FRAME_RATE_HZ = 80.0, 30.0
OCCLUSION_S, OCCLUSION_EVERY_S = 2.0, 10.0
IMAGE_TOPIC = "/camera/color/compressed"


@dataclass(frozen=True)
class Made:
    """A recording on disk.

    Attributes
    ----------
    path : Path
        Without images; `with_images` the same recording with a stream of them, or None.
    truth : Path
        The simulated motion (.npz), which the measured file holds too unless it was left out.
    length_s, samples, frames : float, s, and int
        Of the recording.
    """

    path: Path
    with_images: Path | None
    truth: Path
    minutes: float
    length_s: float
    samples: int
    frames: int


def make(
    folder: Path, minutes: float, preset: str, seed: int, truth_inside: bool, image_kb: float | None
) -> Made:
    """Simulate and write a recording of `OCCLUSION_S` of occlusion about every `OCCLUSION_EVERY_S`.

    Six hours are simulated in one go like any length (103 s and 2.1 GB): nothing is repeated or joined.

    Parameters
    ----------
    truth_inside : bool
        The file holds the true motion too, as `unocclude simulate` writes it.
    image_kb : float, kB, or None
        Size of an image, kB, one a frame; None = no file with images.
    """
    config = ArmSimulation.preset(
        preset,
        protocol="random",
        duration_s=60.0 * minutes,
        imu_rate_hz=IMU_RATE_HZ,
        frame_rate_hz=FRAME_RATE_HZ,
        occlusion_lengths_s=(OCCLUSION_S,),
        occlusion_every_s=OCCLUSION_EVERY_S,
    )
    recording = simulate_arm(config, seed).recording
    truth = recording.truth
    assert truth is not None
    path, truth_path = folder / f"rec{minutes:g}.mcap", folder / f"truth{minutes:g}.npz"
    np.savez(truth_path, t_s=truth.t_s, position=truth.position, quaternion=truth.quaternion)
    if not truth_inside:
        recording = replace(recording, truth=None)
    write_recording(recording, path)
    with_images = None
    if image_kb is not None:
        with_images = folder / f"images{minutes:g}.mcap"
        add_images(path, with_images, recording, round(1000 * image_kb))
    return Made(
        path=path,
        with_images=with_images,
        truth=truth_path,
        minutes=minutes,
        length_s=float(recording.imu.t_s[-1] - recording.imu.t_s[0]),
        samples=len(recording.imu),
        frames=len(recording.arm),
    )


def read_truth(path: Path, origin_ns: int) -> Truth:
    """The truth, its times counted from `origin_ns`."""
    with np.load(path) as kept:
        t_s = kept["t_s"] - 1e-9 * origin_ns
        return Truth(t_s, kept["position"], kept["quaternion"], np.ones(len(t_s), dtype=bool))


def add_images(source: Path, target: Path, recording: Recording, image_bytes: int) -> None:
    """Copy an MCAP file with a `foxglove.CompressedImage` for every camera frame between its messages.

    What is in the images are random bytes: like a JPEG they do not compress, and nothing may look at them.
    """
    from mcap.reader import make_reader
    from mcap.writer import Writer

    message = message_class("foxglove.CompressedImage")(frame_id="camera", format="jpeg")
    rng = np.random.default_rng(0)
    stamps = (np.round(recording.arm.t_s * 1e9).astype(np.int64) + recording.origin_ns).tolist()
    with source.open("rb") as old, target.open("wb") as new:
        reader, writer = make_reader(old), Writer(new)
        writer.start(profile=reader.get_header().profile, library="tools.benchmark")
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        name = "foxglove.CompressedImage"
        images = writer.register_channel(
            IMAGE_TOPIC, "protobuf", writer.register_schema(name, "protobuf", schema_data(name))
        )
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        sent = 0

        def send(until_ns: float) -> None:
            nonlocal sent
            while sent < len(stamps) and stamps[sent] < until_ns:
                stamp = stamps[sent]
                message.timestamp.FromNanoseconds(stamp)
                message.data = rng.bytes(image_bytes)
                writer.add_message(images, stamp, message.SerializeToString(), stamp, sent)
                sent += 1

        for schema, channel, each in reader.iter_messages():
            send(each.log_time)
            if channel.id not in channels:
                if schema is not None and schema.id not in schemas:
                    schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas[schema.id] if schema else 0,
                    channel.metadata,
                )
            writer.add_message(
                channels[channel.id], each.log_time, each.data, each.publish_time, each.sequence
            )
        send(float("inf"))
        writer.finish()
