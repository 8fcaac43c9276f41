"""Every page in a real browser: nothing complains, nothing comes from outside, what can be pressed works."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import report_pages
from arms import make_recording, make_recovery, write_page
from browser import Browser

from smoother.measurements.visibility import Reason
from smoother.recording import CameraFrame
from smoother.result import Estimates

#: What a file may call itself; none of it may be obeyed.
EVIL = "</script><script>hacked=1</script><img src=x onerror=hacked=1><b>bold</b>&amp;"
#: Whether something was drawn: colours on a canvas, and how many of its points have another than the first.
PAINTED = """(() => [...document.querySelectorAll("canvas")].map((canvas) => {
  const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let other = 0;
  for (let i = 0; i < data.length; i += 4) other += data[i] !== data[0] || data[i + 1] !== data[1];
  return other;
}))()"""


def unfold(browser: Browser) -> None:
    """Open what is folded, and wait until all of it is drawn."""
    browser.run("document.querySelectorAll('details.more').forEach((each) => (each.open = true))")
    browser.wait("[...document.querySelectorAll('.plot')].every((each) => each.dataset.drawn)")
    browser.wait("document.documentElement.dataset.drawn === 'yes'")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pages")


@pytest.fixture
def player(browser: Browser, folder: Path) -> Browser:
    """The page of `smooth`, open in a window of a desk."""
    page = folder / "smooth.html"
    if not page.exists():
        report_pages.smooth(folder)
    browser.dark(False)
    browser.size(1100, 900)
    browser.open(page)
    browser.run("document.querySelector('.space').scrollIntoView()")
    return browser


@pytest.mark.slow
def test_a_link_into_what_is_folded_opens_it(player: Browser):
    assert player.run("document.querySelector('details.more').open") is False
    player.run("location.hash = '#settings'")
    player.wait("document.querySelector('details.more').open")
    player.wait("Math.abs(document.querySelector('#settings').getBoundingClientRect().top) < innerHeight")
    player.run("history.replaceState(null, '', ' ')")


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height", "beside"), [(1280, 900, True), (390, 844, False)])
def test_the_first_screen(player: Browser, width: int, height: int, beside: bool):
    """A large verdict, and the moving arm beside it; on a phone under it."""
    player.size(width, height, phone=not beside)
    player.run("scrollTo(0, 0)")
    box = "document.querySelector('%s').getBoundingClientRect()"
    verdict, arm = box % ".summary .large", box % ".beside canvas"
    player.wait(f"{arm}.right <= {width} && {verdict}.height > 0")
    where = player.run(
        f"[{verdict}.right < {arm}.left, {verdict}.bottom < {arm}.top, {arm}.bottom < innerHeight]"
    )
    assert where == ([True, where[1], True] if beside else [False, True, where[2]])
    assert player.run("parseFloat(getComputedStyle(document.querySelector('.large')).fontSize)") >= 28
    assert player.run("document.documentElement.scrollWidth") <= width


def test_on_a_phone_view_and_controls_are_on_one_screen(player: Browser):
    player.size(390, 664, phone=True)
    player.run("dispatchEvent(new Event('resize'))")
    player.wait("document.querySelector('.space canvas').clientWidth < 390")
    player.run("document.querySelector('.space').scrollIntoView()")
    player.wait("document.querySelector('.space .legend').getBoundingClientRect().bottom <= innerHeight")
    wide = "[...document.querySelectorAll('.space button, .space label, .space select')]"
    assert player.run(f"{wide}.every((each) => each.getBoundingClientRect().right <= innerWidth)")
    titles = "[...document.querySelectorAll('.plot .annotation-text, .plot .ytitle, .plot .xtitle')]"
    assert player.run(
        f"{titles}.every((each) => {{const b = each.getBoundingClientRect();"
        " return b.left >= 0 && b.right <= innerWidth;})"
    )


def now(browser: Browser) -> float:
    """The time of the slider, s."""
    return float(browser.run("Number(document.querySelector('[data-do=seek]').value)"))


def middle(browser: Browser, selector: str) -> tuple[float, float]:
    """The middle of an element in the window."""
    x, y = browser.run(
        f"(() => {{const b = document.querySelector({selector!r}).getBoundingClientRect();"
        " return [b.x + b.width / 2, b.y + b.height / 2];})()"
    )
    return x, y


def press(browser: Browser, name: str) -> None:
    browser.click(*middle(browser, f"[data-do={name}]"))


#: Pages without a plot.
TABLES_ALONE = ("study", "measures")


@pytest.mark.slow
@pytest.mark.parametrize("name", report_pages.PAGES)
def test_every_page_opens_on_a_desk_and_on_a_phone(name: str, browser: Browser, folder: Path):
    page = folder / f"{name}.html"
    if not page.exists():
        page = report_pages.PAGES[name](folder)
    assert page.stat().st_size < 6e6
    for dark, width, phone in ((False, 1100, False), (True, 390, True)):
        browser.dark(dark)
        browser.size(width, 800, phone=phone)
        browser.open(page)
        assert browser.complaints() == [] and browser.loaded() == []
        assert browser.run("typeof hacked") == "undefined"
        if name in ("smooth", "validate"):
            assert width < 1000 or browser.run("document.documentElement.scrollHeight") < 8000
        unfold(browser)
        plots, drawn, spaces = browser.run(
            "['.plot', '.plot .main-svg', '.space'].map((s) => document.querySelectorAll(s).length)"
        )
        assert name in TABLES_ALONE or plots + spaces > 0
        assert drawn >= plots
        assert len(painted := browser.run(PAINTED)) == spaces and all(count > 300 for count in painted)
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")
        bright = browser.run("getComputedStyle(document.body).backgroundColor.match(/\\d+/g)[0] > 128")
        assert bright is not dark
    broken = browser.run(
        "[...document.querySelectorAll('.contents a')].filter((a) => !document.querySelector("
        "'#' + CSS.escape(a.hash.slice(1)))).length"
    )
    assert broken == 0
    if name in ("study", "measures", "progress"):  # whose names are hostile
        assert report_pages.HOSTILE_NAME in browser.run("document.body.textContent")
        assert browser.run("document.querySelectorAll('img[src=x]').length") == 0


@pytest.mark.slow
def test_it_plays_and_stops(player: Browser):
    player.run("unocclude.setTime(0)")
    before = player.run(PAINTED)
    press(player, "play")
    player.wait("Number(document.querySelector('[data-do=seek]').value) > 0.3")
    press(player, "play")
    stopped = now(player)
    assert player.run(
        "new Promise((f) => setTimeout(() => f(document.querySelector('.now').textContent), 150))"
    )
    assert now(player) == stopped and player.run(PAINTED) != before
    player.run("document.querySelector('[data-do=speed]').value = '10'")
    press(player, "play")
    player.wait("document.querySelector('[data-do=play]').getAttribute('aria-pressed') === 'false'")
    assert now(player) == pytest.approx(player.run("Number(document.querySelector('[data-do=seek]').max)"))


def test_slider_cursors_and_clicks_are_one_time(player: Browser):
    player.run(
        "(() => {const s = document.querySelector('[data-do=seek]'); s.value = 7.5;"
        " s.dispatchEvent(new Event('input'));})()"
    )
    unfold(player)
    places = """[...document.querySelectorAll(".cursor")].map((line) => {
      const {xaxis} = line.parentElement._fullLayout;
      return xaxis.p2l(parseFloat(line.style.left) - xaxis._offset);})"""
    assert len(player.run(places)) >= 4
    assert player.run(places) == pytest.approx([7.5] * len(player.run(places)), abs=1e-3)
    assert player.run("document.querySelector('.now').textContent").startswith("7.50 s of ")
    player.run("document.querySelector('#figure-how-certain-the-answer-is').scrollIntoView()")
    x, y = middle(player, "#figure-how-certain-the-answer-is")
    player.click(x, y)
    assert now(player) != 7.5
    assert player.run(places) == pytest.approx([now(player)] * len(player.run(places)), abs=0.02)


def test_keys_go_to_gaps_frames_and_play(player: Browser):
    gaps = player.run(
        "JSON.parse(document.querySelector('.player script').textContent).arms[0].gaps.map((gap) => gap[0])"
    )
    assert len(gaps) >= 2
    player.run("unocclude.setTime(0)")
    for start in gaps[:2]:
        player.key("g")
        assert now(player) == pytest.approx(max(start - 0.5, 0), abs=1e-6)
    player.key("G", shift=True)
    assert now(player) == pytest.approx(max(gaps[0] - 0.5, 0), abs=1e-6)
    press(player, "next")
    assert now(player) == pytest.approx(gaps[1] - 0.5, abs=1e-6)
    player.run("document.activeElement.blur()")
    player.key("ArrowRight")
    assert now(player) == pytest.approx(gaps[1] - 0.5 + 1 / 30, abs=2e-3)
    player.key("ArrowLeft", shift=True)
    assert now(player) == pytest.approx(gaps[1] - 1.5 + 1 / 30, abs=0.05)
    player.key(" ")
    player.wait("document.querySelector('[data-do=play]').getAttribute('aria-pressed') === 'true'")
    player.key(" ")
    player.wait("document.querySelector('[data-do=play]').getAttribute('aria-pressed') === 'false'")


@pytest.mark.slow
def test_paper_is_white_and_holds_the_path(player: Browser):
    player.dark(True)
    pdf = player.pdf()
    assert pdf.startswith(b"%PDF") and pdf.count(b"/Type /Page\n") > 5
    player.run("document.querySelector('canvas').style.visibility = 'hidden'")
    assert len(pdf) - len(player.pdf()) > 10_000  # the lines of path, floor and arms
    player.run("document.querySelector('canvas').style.visibility = ''")
    player.run("dispatchEvent(new Event('beforeprint'))")
    first = "[...document.querySelector('canvas').getContext('2d').getImageData(0, 0, 1, 1).data].slice(0, 3)"
    assert player.run(first) == [255, 255, 255] and player.run(PAINTED)[0] > 5000
    assert (
        player.run("Math.max(...[...document.querySelectorAll('.main-svg')].map((s) => s.clientWidth))")
        <= 690
    )
    player.run("dispatchEvent(new Event('afterprint'))")
    assert player.run(first) != [255, 255, 255]
    player.dark(False)


def hostile_result(path: Path) -> Path:
    """A page of `smooth` whose every word of a file is hostile."""
    recording = make_recording(8.0)
    t = recording.arm.t_s
    recording = replace(
        recording,
        arm=recording.arm.hide((t > 3) & (t < 4)),
        camera_frame=CameraFrame.KINECT,
        notes=(f"note {EVIL}",),
        name=EVIL,
        side="",
    )
    recovery = make_recovery(recording, error_m=0.005, sigma_m=0.005)
    residuals = recovery.residuals
    assert residuals is not None
    reason = np.zeros_like(residuals.reason)
    reason[:40] = 1
    recovery = replace(
        recovery,
        name=EVIL,
        side="",
        residuals=replace(
            residuals, reason=reason, used=reason == 0, reasons=(Reason(""), Reason(EVIL, EVIL))
        ),
        config={EVIL: {EVIL: EVIL}},
        estimates=Estimates(trusted=False, reasons=(EVIL,), further={EVIL: EVIL}),
    )
    write_page(recovery, path, recording, truth=recording.truth)
    return path


@pytest.mark.slow
def test_nothing_of_a_file_is_obeyed(browser: Browser, tmp_path: Path):
    browser.size(1100, 800)
    browser.open(hostile_result(tmp_path / "hostile.html"))
    unfold(browser)
    assert browser.run("typeof hacked") == "undefined"
    assert browser.run("document.querySelectorAll('img[src=x], b').length") == 0
    assert browser.complaints() == [] and browser.loaded() == []
    shown = browser.run("document.body.textContent")
    assert EVIL[:70] in shown  # names of topics are cut to 80 characters
