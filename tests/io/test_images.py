"""Images and lenses of recordings: ROS 2 and Foxglove, raw and compressed, damaged ones told."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import ros_bags
from scipy.io import wavfile

from calib.images import read_view, unpacked
from smoother.errors import CalibrationError, RecordingError
from smoother.io.mcap.merge import Output, OutputStream
from smoother.io.rig import panel as panel_files
from smoother.io.rig.clock import read_sound
from smoother.io.rig.images import ImageMessage, raw_image, read_images, serialized
from smoother.io.rig.panel import read_pairs
from smoother.io.rig.strap import check_images
from smoother.io.wire.schemas import message_class
from smoother.runtime.outputs import writing

_TAIL = ros_bags.IMAGE.partition("uint8[] data\n")[2]
COMPRESSED = "std_msgs/Header header\nstring format\nuint8[] data\n" + _TAIL
CAMERA_INFO = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n"
    "float64[9] k\nfloat64[9] r\nfloat64[12] p\n" + _TAIL
)
K = [365.0, 0.0, 250.0, 0.0, 366.0, 210.0, 0.0, 0.0, 1.0]


def pictures() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return rng.integers(0, 4000, (6, 5)).astype(np.uint16), rng.integers(0, 65535, (6, 5)).astype(np.uint16)


def raw(ns: int, frame: str, image: np.ndarray, encoding: str, big: bool = False, pad: int = 0) -> dict:
    rows = image.astype(image.dtype.newbyteorder(">" if big else "<")).view(np.uint8).reshape(len(image), -1)
    rows = np.hstack([rows, np.zeros((len(rows), pad), np.uint8)])
    return {
        "header": ros_bags.header(ns, frame),
        "height": image.shape[0],
        "width": image.shape[1],
        "encoding": encoding,
        "is_bigendian": int(big),
        "step": rows.shape[1],
        "data": rows.tobytes(),
    }


def info(ns: int, model: str, d: list[float]) -> dict:
    names = {"distortion_model": model, "d": d, "k": K, "r": [0.0] * 9, "p": [0.0] * 12}
    return {"header": ros_bags.header(ns, "depth_camera"), "height": 6, "width": 5, **names}


def png(ns: int, frame: str, data: bytes) -> dict:
    return {"header": ros_bags.header(ns, frame), "format": "png", "data": data}


DEFINITIONS = {"Image": ros_bags.IMAGE, "CompressedImage": COMPRESSED, "CameraInfo": CAMERA_INFO}


def written(path: Path, *messages: tuple[str, str, dict, int]) -> Path:
    """A bag of messages: topic, kind, message and log time."""
    with ros_bags.Bag(path) as bag:
        for topic, kind, message, log_ns in messages:
            bag.write(topic, f"sensor_msgs/msg/{kind}", DEFINITIONS[kind], message, log_ns)
    return path


@pytest.mark.parametrize(("big", "pad"), [(False, 0), (True, 0), (False, 6)])
def test_ros_images_come_back(tmp_path: Path, big: bool, pad: int):
    depth, infrared = pictures()
    packed = cv2.imencode(".png", infrared)[1].tobytes()
    lens = info(5_000_000_000, "rational_polynomial", [0.1, -0.2, 0.001, 0.002, 0.05, 0.0, 0.0, 0.0])
    messages = [("/depth/camera_info", "CameraInfo", lens, 5_000_000_000)]
    for k in range(3):  # three frames of one pose
        ns = 5_000_000_000 + k * 33_000_000
        image = raw(ns, "depth_camera", depth + k, "16UC1", big, pad)
        messages.append(("/depth/image_raw", "Image", image, ns))
        messages.append(("/ir/compressed", "CompressedImage", png(ns + 5_000_000, "ir", packed), ns))
    ((first, second),), camera = read_pairs(written(tmp_path / "ros.mcap", *messages))
    np.testing.assert_array_equal(first.pixels(), depth + 1)  # the middle one
    np.testing.assert_array_equal(second.pixels(), infrared)
    assert (first.stamp_ns, first.frame_id) == (5_033_000_000, "depth_camera")
    assert camera is not None and camera.distortion == (0.1, -0.2, 0.001, 0.002, 0.05)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.width) == (365.0, 366.0, 250.0, 210.0, 5)


def test_foxglove_compressed_images_come_back(tmp_path: Path):
    depth, _ = pictures()
    _, packed = cv2.imencode(".png", depth)
    message = serialized("foxglove.CompressedImage", 7, frame_id="c", format="png", data=packed.tobytes())
    with writing(tmp_path / "a.mcap") as temporary, Output(temporary) as output:
        output.write([output.each("/depth", "foxglove.CompressedImage", np.array([7]), lambda _: message)])
    (image,) = read_images(tmp_path / "a.mcap")
    assert isinstance(image, ImageMessage) and image.stamp_ns == 7
    np.testing.assert_array_equal(image.pixels(), depth)


def test_what_cannot_be_read_is_told(tmp_path: Path):
    depth, infrared = pictures()
    odd = ("/depth", "Image", raw(1, "c", depth, "bayer_rggb16"), 1)
    broken = ("/infrared", "CompressedImage", png(2, "c", b"nothing"), 2)
    for image in read_images(written(tmp_path / "odd.mcap", odd, broken)):
        assert isinstance(image, ImageMessage)
        with pytest.raises(RecordingError, match="cannot be read"):
            image.pixels()
    fisheye = ("/i", "CameraInfo", info(1, "equidistant", [0.1] * 4), 1)
    with pytest.raises(RecordingError, match="equidistant"):
        list(read_images(written(tmp_path / "fisheye.mcap", fisheye)))
    alone = ("/depth", "Image", raw(1, "c", depth, "16UC1"), 1)
    with pytest.raises(RecordingError, match="no infrared images"):
        read_pairs(written(tmp_path / "alone.mcap", alone))
    late = ("/infrared", "Image", raw(1_000_000_000, "c", infrared, "mono16"), 2)
    with pytest.raises(RecordingError, match="no stamps in common"):
        read_pairs(written(tmp_path / "apart.mcap", alone, late))


def test_a_damaged_message_of_an_image_or_of_sound_is_left_out_and_told(tmp_path: Path):
    depth, _ = pictures()
    path = tmp_path / "damaged.mcap"
    image, lens = raw_image("c", "16UC1", depth, 7), b"\n\x02"  # field 1 is cut off
    sound = message_class("foxglove.RawAudio")(
        data=bytes(8), format="pcm-s16", sample_rate=8000, number_of_channels=1
    )
    payloads = {
        "foxglove.RawImage": [image, b"\x0a\xff", image],
        "foxglove.CameraCalibration": [lens],
        "foxglove.RawAudio": [sound.SerializeToString(), b"\x0a\xff"],
        "foxglove.FrameTransforms": [b"\x0a\xff"],
        "foxglove.SceneUpdate": [b"\x12\xff"],
    }
    with writing(path) as temporary, Output(temporary) as output:
        for name, data in payloads.items():
            channel = output.channel(f"/marker/{name}", name)
            stamps = np.arange(7, 7 + len(data))
            output.write([OutputStream(channel, stamps, lambda part, data=data: data[part])])
    notes: list[str] = []
    assert [type(each) for each in read_images(path, notes=notes)] == [ImageMessage] * 2
    assert notes == ["damaged.mcap: damaged messages of images, left out: 2."]
    heard: list[str] = []
    (track,) = read_sound(path, notes=heard)
    assert len(track.samples) == 4
    assert heard == ["damaged.mcap: damaged messages of sound, left out: 1."]
    with pytest.raises(RecordingError, match="no colour"):
        check_images(path)  # the frames' tree is read first
    with pytest.raises(RecordingError, match="no mocap markers"):
        panel_files._markers_at(path, np.zeros(1, np.int64))


def test_files_that_break_off_or_state_too_much(tmp_path: Path):
    """OpenCV takes 4 GB and half a minute for such a PNG; it looks at the size of other formats itself."""
    depth, _ = pictures()
    whole, jpeg = (
        cv2.imencode(".png", depth)[1].tobytes(),
        cv2.imencode(".jpg", depth.astype("u1"))[1].tobytes(),
    )
    np.testing.assert_array_equal(unpacked(whole), depth)
    assert unpacked(jpeg).shape == (6, 5)
    at = whole.index(b"IDAT") - 4
    data = whole[:at] + b"\xf8\xff\xff\xc9" + whole[at + 4 :]
    head = whole[12:16] + struct.pack(">II", 60_000, 60_000) + whole[24:29]
    huge = whole[:12] + head + struct.pack(">I", zlib.crc32(head)) + whole[33:]
    for broken, said in (
        (b"GIF89a", "neither"),
        (b"", "neither"),
        (whole[:20], "breaks off"),
        (jpeg[:40], "damaged"),
    ):
        with pytest.raises(ValueError, match=said):
            unpacked(broken)
    wavfile.write(tmp_path / "a.wav", 8000, np.zeros(8, np.int16))
    sound = (tmp_path / "a.wav").read_bytes()
    for name, content, said in (
        ("a.png", data, r"a\.png is not an image .*breaks off"),
        ("a.png", huge, r"a\.png is not an image .*larger than"),
        ("a.pgm", b"P5 2000000000 9000 65535\n", r"a\.pgm is not an image .*larger than"),
        ("a.wav", sound.replace(b"data", b"dL\0a"), r"a\.wav is not a WAV file that can be read"),
        ("a.wav", b"RF64" + sound[4:], r"a\.wav is not a WAV file that can be read"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises((CalibrationError, RecordingError), match=said):
            if name == "a.wav":
                read_sound(tmp_path / name)
            else:
                read_view(tmp_path / name, tmp_path / name)
