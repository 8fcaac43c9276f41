"""Pictures in a report: opt-in, in time with the arm, small, and refused in words where there are none."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from pathlib import Path

import cv2
import numpy as np
import pytest
from arms import make_recording, make_recovery
from strap_recordings import with_images

from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io import write_recording
from smoother.report import write_report
from smoother.report.film import MOST_BYTES, image_topic, make_film, recorded_film, video_film
from smoother.simulation import ArmSimulation, simulate_arm


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "images.mcap"
    with_images(simulate_arm(ArmSimulation(protocol="random", duration_s=4.0), 6), path, every=6)
    return path


def video(path: Path, seconds: float, rate_hz: int = 20) -> Path:
    """A film whose brightness is its time: 20 a second."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate_hz, (640, 360))
    for k in range(round(seconds * rate_hz)):
        writer.write(np.full((360, 640, 3), 20 * k / rate_hz, np.uint8))
    writer.release()
    return path


def test_a_films_pictures_stand_at_their_times(tmp_path):
    recovery = make_recovery(make_recording(8.0))
    film = video_film(video(tmp_path / "v.avi", 10.0), -1.0, recovery)
    shown = [cv2.imdecode(np.frombuffer(one, np.uint8), 0) for one in film.jpeg]
    assert shown[0].shape == (180, 320) and 0.09 < np.median(np.diff(film.times_s)) < 0.11
    for t, picture in zip(film.times_s, shown, strict=True):  # it began 1 s before the recording
        assert picture.mean() == pytest.approx(20 * (t - recovery.t_s[0] + 1.0), abs=3.0)
    with pytest.raises(RecordingError, match="--video-offset"):
        video_film(tmp_path / "v.avi", 60.0, recovery)
    (tmp_path / "text.mp4").write_text("no film")
    with pytest.raises(RecordingError, match="cannot be read as a video"):
        video_film(tmp_path / "text.mp4", 0.0, recovery)
    with pytest.raises(RecordingError, match="does not exist"):
        video_film(tmp_path / "none.mp4", 0.0, recovery)


def test_a_long_film_is_thinned():
    rng = np.random.default_rng(0)
    loud = [rng.integers(0, 255, (240, 320, 3), dtype=np.uint8) for _ in range(8)]
    images = ((k / 30, loud[k % 8]) for k in range(30 * 600))
    film = make_film(images, 0.0, 600.0, "noise")
    assert film is not None and sum(map(len, film.jpeg)) < 1.6 * MOST_BYTES
    assert len(film.jpeg) < 0.5 * 10 * 600


def test_the_recordings_own_images_are_on_the_page_only_when_asked_for(session, tmp_path):
    assert image_topic(session) == "/colour/image", "not the depth beside it"
    shown, hidden = tmp_path / "shown.html", tmp_path / "hidden.html"
    again = (
        "smooth",
        session,
        "--processes",
        1,
        "--draws",
        0,
        "--force",
        "-o",
        tmp_path / "o.mcap",
        "--report",
    )
    for page, options in ((shown, ("--with-images",)), (hidden, ())):
        assert run([str(each) for each in (*again, page, *options)]) == 0
    text = shown.read_text(encoding="utf-8")
    block = re.search(r'<script type="application/json">(\{"view".*?)</script>', text, re.DOTALL)
    assert block is not None
    pictures = json.loads(block.group(1))["pictures"]
    assert len(pictures["jpeg"]) > 12 and np.all(np.diff(pictures["times"]) > 0)
    assert b64decode(pictures["jpeg"][0]).startswith(b"\xff\xd8")
    assert "anyone who has the page sees the person" in text
    without = hidden.read_text(encoding="utf-8")
    assert "sees the person" not in without and '"pictures":null' in without.replace(" ", "")


def test_what_cannot_be_shown_is_refused_before_the_work(session, tmp_path, capsys):
    write_recording(make_recording(4.0), tmp_path / "bare.mcap")
    report = ("--report", tmp_path / "r.html")
    for source, options, words in (
        (tmp_path / "bare.mcap", ("--with-images", *report), "has no images"),
        (session, ("--with-images",), "--report"),
        (session, ("--with-images", "--video", tmp_path / "v.avi", *report), "give one"),
        (session, ("--video-offset", 2, *report), "--video FILE"),
        (session, ("--video", tmp_path / "none.mp4", *report), "does not exist"),
    ):
        assert run([str(each) for each in ("smooth", source, "-o", tmp_path / "o.mcap", *options)]) != 0
        assert words in capsys.readouterr().err and not (tmp_path / "o.mcap").exists()


def test_pictures_need_no_other_file(session, tmp_path):
    recovery = make_recovery(make_recording(4.0))
    film = recorded_film(session, recovery)
    write_report(recovery, tmp_path / "r.html", film=film)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert [each.name for each in tmp_path.iterdir()] == ["r.html"]
    assert 'class="film"' in text and "src=" not in re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
