"use strict";
/* Draws the page's plots one after the other, the first ones first, so that the page can be read at once.
   `unocclude.cursor` is the time that the player and all plots over time share. */
var unocclude = (() => {
  const boxes = [...document.querySelectorAll(".plot")];
  const timed = [];
  const listeners = [];
  const page = { time: null, range: null, data, setTime, onTime: (f) => listeners.push(f), beforePrint: [], afterPrint: [] };

  function data(box) {
    return JSON.parse(box.parentElement.querySelector('script[type="application/json"]').textContent);
  }

  function draw(box) {
    if (box.dataset.drawn) return;
    box.dataset.drawn = "yes";
    const { data: traces, layout } = data(box);
    const narrow = box.clientWidth < 640;
    if (narrow && layout.margin) Object.assign(layout.margin, { l: Math.min(layout.margin.l, 52), r: 8 });
    if (narrow) layout.font = Object.assign({}, layout.font, { size: 11 });
    layout.autosize = true;
    if (layout.meta && layout.meta.time && page.range)
      for (const name in layout) if (/^xaxis/.test(name) && !layout[name].range) layout[name].range = [...page.range];
    Plotly.newPlot(box, traces, layout, {
      displaylogo: false, responsive: true, plotlyServerURL: "", displayModeBar: narrow ? false : "hover",
    });
    if (layout.meta && layout.meta.time) follow(box);
  }

  /* A line at the shared time; a click moves it there. */
  function follow(box) {
    const line = document.createElement("div");
    line.className = "cursor";
    box.appendChild(line);
    const place = () => {
      const full = box._fullLayout, axis = full && full.xaxis;
      if (!axis || page.time === null) return void (line.hidden = true);
      const x = axis.l2p(page.time);
      line.hidden = !(x >= 0 && x <= axis._length);
      line.style.left = axis._offset + x + "px";
      line.style.top = full._size.t + "px";
      line.style.height = full._size.h + "px";
    };
    box.on("plotly_afterplot", place);
    let from = null;
    box.addEventListener("pointerdown", (e) => (from = [e.clientX, e.clientY]), true);
    box.addEventListener("pointerup", (e) => {
      const axis = box._fullLayout.xaxis, size = box._fullLayout._size, at = box.getBoundingClientRect();
      const moved = !from || Math.hypot(e.clientX - from[0], e.clientY - from[1]) > 4;
      const x = e.clientX - at.left - axis._offset, y = e.clientY - at.top - size.t;
      if (!moved && page.time !== null && x >= 0 && x <= axis._length && y >= 0 && y <= size.h)
        setTime(axis.p2l(x), box);
    }, true);
    timed.push(place);
    place();
  }

  function setTime(t, source) {
    page.time = t;
    for (const place of timed) place();
    for (const listener of listeners) listener(t, source);
  }

  /* What is folded is drawn when it is opened. */
  const open = (box) => !box.closest("details.more:not([open])");
  function next(rest) {
    if (!rest.length) return void (document.documentElement.dataset.drawn = "yes");
    if (open(rest[0])) draw(rest[0]);
    setTimeout(() => next(rest.slice(1)), 0);
  }
  addEventListener("toggle", (e) => {
    if (!e.target.open || !e.target.matches("details.more")) return;
    document.documentElement.dataset.drawn = "";
    next(boxes.filter((box) => e.target.contains(box)));
  }, true);
  function unfold() { // what an address or a link names
    const at = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    for (let each = at && at.closest("details"); each; each = each.parentElement.closest("details")) each.open = true;
    if (at) at.scrollIntoView();
  }
  addEventListener("hashchange", unfold);
  addEventListener("DOMContentLoaded", () => { unfold(); setTimeout(() => next(boxes), 0); });

  /* Paper is narrower than a screen, and white. */
  const PAPER = 690;
  let folded = [];
  addEventListener("beforeprint", () => {
    folded = [...document.querySelectorAll("details.more:not([open])")];
    for (const each of folded) each.open = true;
    for (const box of boxes) {
      draw(box);
      if (box.clientWidth > PAPER) Plotly.relayout(box, { width: PAPER, autosize: false });
    }
    for (const f of page.beforePrint) f();
  });
  addEventListener("afterprint", () => {
    for (const box of boxes) Plotly.relayout(box, { width: null, autosize: true });
    for (const each of folded) each.open = false;
    for (const f of page.afterPrint) f();
  });
  return page;
})();
