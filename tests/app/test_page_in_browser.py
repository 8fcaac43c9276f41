"""The whole way in a real browser: from files that are dropped to a report that plays, and the wrong ways."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from browser import Browser
from local_page import DAY_S, own_table, write_session
from local_program import Program

#: A recovery on a machine that others use, s.
PATIENCE_S = 400.0


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Program]:
    program = Program(tmp_path / "recordings")
    yield program
    program.close()


def opened(browser: Browser, program: Program, width: int = 1280) -> None:
    """The first page, as by a click on the address."""
    browser.size(width, 900, phone=width < 500)
    browser.call("Page.navigate", url="about:blank")
    browser.wait("location.href === 'about:blank'")  # an earlier page asks no more
    browser.events.clear()
    browser.call("Page.navigate", url=program.address)
    browser.wait("document.documentElement?.dataset.drawn === 'yes' && !!document.querySelector('.drop')")
    assert "token" not in browser.run("location.href")


def choose(browser: Browser, *files: Path) -> None:
    """Choose files, as by the button."""
    root = browser.call("DOM.getDocument")["root"]["nodeId"]
    node = browser.call("DOM.querySelector", nodeId=root, selector="[data-input=files]")["nodeId"]
    browser.call("DOM.setFileInputFiles", files=[str(path) for path in files], nodeId=node)


def drop(browser: Browser, *files: Path) -> None:
    """Drop files on the page."""
    box = browser.run(
        "(({x, y, width}) => [x + width / 2, y + 20])"
        "(document.querySelector('.drop').getBoundingClientRect())"
    )
    data: dict[str, Any] = {"items": [], "files": [str(path) for path in files], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        browser.call("Input.dispatchDragEvent", type=kind, x=box[0], y=box[1], data=data)


def press(browser: Browser, selector: str) -> None:
    browser.wait(f"!!document.querySelector('{selector}:not(:disabled)')")
    browser.run(f"document.querySelector('{selector}').click()")


def elsewhere(browser: Browser, *addresses: str) -> list[str]:
    """Addresses other than the program's that the browser asked for."""
    urls = [
        event["params"]["request"]["url"]
        for event in browser.events
        if event.get("method") == "Network.requestWillBeSent"
    ]
    asked, homes = [urlsplit(url) for url in urls], {urlsplit(each).netloc for each in addresses}
    assert any(url.netloc in homes for url in asked)
    own = ("data", "blob", "about")
    return [url.geturl() for url in asked if url.scheme not in own and url.netloc not in homes]


def children_s() -> float:
    """Processor time of processes that have ended, and of theirs, s."""
    used = os.times()
    return used.children_user + used.children_system


@pytest.mark.slow
def test_from_files_to_a_playing_report(browser: Browser, program: Program, session_files: dict[str, Path]):
    """On a phone's width; files as devices export them; nothing goes elsewhere."""
    opened(browser, program, width=390)
    begin, used_s = time.monotonic(), children_s()
    drop(browser, session_files["skeleton"], session_files["imu"])
    browser.wait("document.querySelectorAll('.plots svg').length === 3")
    plots = "[...document.querySelectorAll('.plots svg')]"
    labels = browser.run(f"{plots}.map(each => each.getAttribute('aria-label'))")
    assert any("wrist right, m, over 33." in label for label in labels)
    press(browser, "#recover")
    browser.wait("!!document.querySelector('#bar')")
    seen = set()
    while not browser.run("!!document.querySelector('#report, #ended')"):
        seen.add(browser.run("document.querySelector('#bar')?.value ?? 0"))
        assert time.monotonic() - begin < 400
        time.sleep(0.2)
    assert browser.run("document.querySelector('#ended')?.textContent ?? ''") == ""
    assert len(seen) > 3, "the bar moved"
    assert browser.run("document.documentElement.scrollWidth") <= 390, "nothing is wider than the phone"
    report = browser.run("document.querySelector('#report').src")
    assert not elsewhere(browser, program.address) and not browser.complaints()
    press(browser, "#export")
    link = "document.querySelector('a[download=\"recovered.csv\"]')"
    browser.wait(f"!!{link}")
    table = browser.run(f"fetch({link}.href).then(each => each.text())")
    assert table.startswith("t_s,occluded,imu_x") and table.count("\n") == 2659
    browser.call("Page.navigate", url=report)
    browser.wait("document.documentElement?.dataset.drawn === 'yes'")
    slider = "document.querySelector('.player input[type=range]')"
    before = float(browser.run(f"{slider}.value"))
    browser.run("document.querySelector('.player [data-do=play]').click()")
    browser.wait(f"Number({slider}.value) !== {before}")
    assert not elsewhere(browser, program.address) and not browser.complaints()
    program.close()
    assert 3 < children_s() - used_s < 60, "processor time: less passes without other work"


@pytest.mark.slow
def test_a_killed_server_a_closed_tab_and_a_cancel(
    browser: Browser, program: Program, session_files: dict[str, Path]
):
    """Files one after the other; the job ends with the server; the page goes on by itself."""
    opened(browser, program)
    choose(browser, session_files["imu"])
    browser.wait("!!document.querySelector('.said.care')")
    assert "There is no skeleton" in browser.run("document.querySelector('.said.care').textContent")
    choose(browser, session_files["skeleton"])
    browser.wait("document.querySelectorAll('.plots svg').length === 3")
    press(browser, "#check")
    browser.wait("!!document.querySelector('#bar')")
    place = browser.run("location.hash")
    program.kill()
    browser.wait("!document.querySelector('#trouble').hidden")
    assert "unocclude app" in browser.run("document.querySelector('#trouble').textContent")
    browser.call("Page.navigate", url="about:blank")  # the tab is closed
    before = program.address
    program.start()
    (here, secret), old = program.address.split("?"), before.split("?")[1]
    assert secret != old, "a new secret"
    browser.call("Page.navigate", url=f"{here}?{old}{place}")
    browser.wait("document.body.textContent.includes('Open the address that `unocclude app` printed')")
    browser.call("Page.navigate", url=f"{program.address}{place}")
    browser.wait("!!document.querySelector('#bar, #ended, #check-step .chip')")
    if browser.run("!!document.querySelector('#cancel')"):
        press(browser, "#cancel")
        browser.wait("!!document.querySelector('#ended, #check-step .chip')")
    state = json.loads((program.only() / "job" / "job.json").read_text())
    assert (
        state["state"] in ("cancelled", "done", "stopped")
        and len(list((program.only() / "files").iterdir())) == 2
    )
    assert not elsewhere(browser, program.address, before)


@pytest.mark.slow
def test_a_missing_file_two_sessions_and_a_mirror(
    browser: Browser, program: Program, session_files: dict[str, Path], tmp_path: Path
):
    """Each is said in the command's sentence; the files stay, and the step is repeated or undone in place."""
    ended = "document.querySelector('#ended')?.textContent ?? ''"
    opened(browser, program)
    choose(browser, session_files["imu"])
    browser.wait("document.querySelectorAll('.plots svg').length === 2")
    press(browser, "#recover")
    browser.wait(f"({ended}).includes('skeleton')")
    choose(browser, session_files["other_skeleton"])
    browser.wait("document.querySelectorAll('.plots svg').length === 3")
    press(browser, "#recover")
    browser.wait(f"({ended}).includes('mixes sessions')")
    sentence = browser.run(ended)
    assert "files/shimmer.csv (2026-03-12)" in sentence and "2026-03-21" in sentence
    press(browser, "#repeat")
    browser.wait("!!document.querySelector('#bar')")
    browser.wait(f"({ended}).includes('mixes sessions')")
    press(browser, 'button[aria-label="Remove kinect.csv"]')
    browser.wait("!document.querySelector('button[aria-label=\"Remove kinect.csv\"]')")
    mirrored = write_session(tmp_path / "mirrored", mirror=True)["skeleton"]
    browser.wait("!!document.querySelector('#recover:not(:disabled)')")
    choose(browser, mirrored)
    browser.wait("document.querySelectorAll('.plots svg').length === 3")
    press(browser, "#recover")
    patiently(browser, f"({ended}).includes('see step 3')")
    assert not browser.run("!!document.querySelector('#report')")
    press(browser, ".remedy")
    browser.wait("!!document.querySelector('#cancel')")
    press(browser, "#cancel")
    browser.wait(f"({ended}).startsWith('Cancelled')")
    job = program.only() / "job" / "job.json"
    steps = [each["argv"] for each in json.loads(job.read_text())["steps"]]
    assert all("--mirror x" in " ".join(words) for words in steps if words[0] in ("check", "smooth"))
    assert json.loads((program.only() / "app.json").read_text())["choices"]["remedy"] == "--mirror x"
    browser.size(390, 900, phone=True)
    browser.run("location.hash = '#/'")
    browser.wait("document.querySelector('table.list')?.textContent.includes('mirrored')")
    assert browser.run("document.querySelector('.chip').getBoundingClientRect().height") < 40
    assert browser.run("document.documentElement.scrollWidth") <= 390


@pytest.mark.slow
def test_a_table_that_nobody_knows_is_described_in_place(
    browser: Browser, program: Program, session_files: dict[str, Path], tmp_path: Path
):
    """Its columns are chosen from lists; what is wrong is said; then it is read, and kept as a template."""
    opened(browser, program)
    choose(browser, own_table(tmp_path / "eigen.csv", session_files["imu"]))
    browser.wait("!!document.querySelector('form.template .keep:not(:disabled)')")
    assert "[object" not in browser.run("document.body.textContent")
    columns = {"t": "Zeit", "time_unit": "ms", "accelerometer_unit": "g", "gyroscope_unit": "deg/s"}
    columns |= {
        f"{letter}{axis}": f"{letter.upper().replace('A', 'F').replace('G', 'D')}{k}"
        for letter in "ag"
        for k, axis in enumerate("xyz", 1)
    }
    for name, value in columns.items():
        if name != "gz":
            browser.run(f"document.querySelector('.template [name=\"{name}\"]').value = {value!r}")
    press(browser, ".keep")
    browser.wait("!document.querySelector('#trouble').hidden")
    assert "lack gz" in browser.run("document.querySelector('#trouble').textContent")
    browser.run(f"document.querySelector('.template [name=gz]').value = {columns['gz']!r}")
    press(browser, ".keep")
    browser.wait("document.querySelectorAll('.plots svg').length === 2")
    (template,) = (program.folder / ".unocclude" / "templates").iterdir()
    assert 'ax = "F1"' in template.read_text()


def patiently(browser: Browser, condition: str) -> None:
    """Wait for what takes longer than a page does."""
    end = time.monotonic() + PATIENCE_S
    while not browser.run(condition):
        assert time.monotonic() < end, f"never came true: {condition}"
        time.sleep(0.3)


@pytest.mark.slow
def test_a_batch_of_a_person(browser: Browser, program: Program, tmp_path: Path):
    """Two folders are dropped; both are recovered with the choices of one."""
    for name, start_s in (("first", 0.0), ("later", 9 * DAY_S)):
        write_session(tmp_path / name, start_s=start_s, repetitions=1)
    opened(browser, program)
    drop(browser, tmp_path / "first", tmp_path / "later")
    press(browser, "#folders_several")
    browser.wait("document.querySelectorAll('table.list tbody tr').length === 2")
    idle = "fetch('/api/state').then(each => each.json()).then(({recordings}) => recordings.every("
    browser.wait(idle + "each => each.files === 2 && each.job?.state === 'done'))")
    links = browser.run("[...document.querySelectorAll('table.list a')].map(each => [each.text, each.hash])")
    for name, place in links:
        browser.run(f"location.hash = {place!r}")
        browser.wait(f"document.querySelector('h1')?.textContent === {name!r}")
        browser.wait("!!document.querySelector('.plots svg') && !!document.querySelector('#f-person')")
        browser.run("document.querySelector('#f-person').value = 'p1'")
        browser.run("document.querySelector('form').requestSubmit()")
        browser.wait("document.querySelector('#said').textContent === 'Saved.'")
        browser.run("document.querySelector('#said').textContent = ''")
        if name == "first":
            browser.wait("!!document.querySelector('select[id^=worn]')")
            change = "each.value = 'forearm_right'; each.dispatchEvent(new Event('change'));"
            browser.run(f"(each => {{ {change} }})(document.querySelector('select[id^=worn]'))")
    browser.run("location.hash = '#/'")
    browser.wait("document.querySelectorAll('table.list input').length === 2")
    dates = browser.run(
        "[...document.querySelectorAll('table.list td:nth-child(4)')].map(n => n.textContent)"
    )
    assert sorted(dates) == ["2026-03-12", "2026-03-21"]
    browser.run("document.querySelectorAll('table.list input').forEach(each => each.click())")
    like = dict(links)["first"].rpartition("/")[2]
    browser.run(f"document.querySelector('#like').value = {like!r}")
    press(browser, "#batch")
    browser.wait("document.querySelector('#said').textContent.startsWith('2 ')")
    patiently(browser, idle + "each => each.recovered && each.job.state === 'done'))")
    for each in program.folder.glob("*/app.json"):
        chosen = json.loads(each.read_text())["choices"]["places"]
        assert chosen == {"shimmer.csv": "forearm_right"}, "those of the first"
        assert "forearm_right=files/shimmer.csv" in (each.parent / "job" / "job.json").read_text()
    browser.wait("document.querySelectorAll('.chip.good, .chip.care').length === 2")
    assert not elsewhere(browser, program.address) and not browser.complaints()


@pytest.mark.slow
def test_by_keyboard(browser: Browser, program: Program, session_files: dict[str, Path], tmp_path: Path):
    """Every control has a name, focus goes with the view, contrast holds in the light and the dark scheme."""
    for kind in ("imu", "skeleton"):  # a folder for each device, and files of one name in them
        (tmp_path / "Montag" / kind).mkdir(parents=True)
        shutil.copy(session_files[kind], tmp_path / "Montag" / kind / "data.csv")
    opened(browser, program)
    drop(browser, tmp_path / "Montag")
    press(browser, "#folders_one")
    browser.wait("document.querySelectorAll('.plots svg').length === 3")
    files = browser.run(
        "[...document.querySelectorAll('ul.files li > span:first-child')].map(e => e.textContent)"
    )
    assert (
        len(files) == 2
        and "data.csv" in files
        and set(files) < {"data.csv", "imu_data.csv", "skeleton_data.csv"}
    )
    assert browser.run("[document.activeElement.tagName, document.activeElement.textContent]") == [
        "H1",
        "Montag",
    ]
    controls = "'button, select, input:not([type=file]), a, progress, iframe'"
    nameless = browser.run(
        f"[...document.querySelectorAll({controls})].filter(each => !(each.getAttribute('aria-label')"
        " || each.title || each.labels?.length || each.tagName !== 'SELECT' && each.textContent.trim()))"
        ".map(each => each.outerHTML)"
    )
    assert nameless == []
    for dark in (False, True):
        browser.dark(dark)
        assert browser.run(CONTRAST) == []
    browser.dark(False)
    for _ in range(3):
        browser.key("Tab")
    assert browser.run("document.activeElement !== document.body")
    assert not browser.complaints()


#: Texts whose contrast to what lies behind them is below AA's 4.5.
CONTRAST = """(() => {
  const parts = (text) => text.match(/[\\d.]+/g).map(Number);
  const linear = (v) => (v <= .03928 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4);
  const weight = [.2126, .7152, .0722];
  const light = (c) => c.slice(0, 3).reduce((sum, v, k) => sum + linear(v / 255) * weight[k], 0);
  const behind = (node) => {
    for (; node; node = node.parentElement) {
      const c = parts(getComputedStyle(node).backgroundColor);
      if (c.length < 4 || c[3] > 0) return c;
    }
    return [255, 255, 255];
  };
  const low = [];
  for (const node of document.querySelectorAll('body *')) {
    const hasText = [...node.childNodes].some((each) => each.nodeType === 3 && each.textContent.trim());
    if (!hasText || !node.offsetParent || node.disabled || node.closest('svg, .unseen, option')) continue;
    const [a, b] = [light(parts(getComputedStyle(node).color)), light(behind(node))];
    const ratio = (Math.max(a, b) + .05) / (Math.min(a, b) + .05);
    if (ratio < 4.5) low.push([node.textContent.trim().slice(0, 30), ratio]);
  }
  return low;
})()"""
