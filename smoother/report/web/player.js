"use strict";
/* The arms in motion: a list of arms on one grid of times each, moved by the time that all plots share. */
(() => {
  const { unpack, add } = View3D;
  const REGION = Math.sqrt(7.8147); // of the ellipsoid that contains 95 of 100 cases, in sigmas
  const TRAIL_S = 2, AROUND_S = 15, MOST_PATH = 2500, LONG_S = 90;

  class Arm {
    constructor(plain) {
      Object.assign(this, plain);
      this.tracks = {};
      for (const name of ["joints", "camera", "truth", "sensor", "sigma", "within"])
        if (plain[name]) this.tracks[name] = { values: unpack(plain[name]), width: plain[name].offset.length };
      if (plain.tracked) this.seen = Uint8Array.from(atob(plain.tracked), (c) => c.charCodeAt(0));
    }
    get end() { return this.start + this.step * (this.count - 1); }
    index(t) { return Math.max(0, Math.min(this.count - 1, (t - this.start) / this.step)); }

    /* Point k of a track at a time, in between two rows of the grid. */
    at(track, k, t) {
      const part = this.tracks[track];
      if (!part || k < 0) return null;
      const x = this.index(t), i = Math.floor(x), j = Math.min(i + 1, this.count - 1), s = x - i;
      const p = [0, 1, 2].map((c) => part.values[i * part.width + 3 * k + c]);
      const q = [0, 1, 2].map((c) => part.values[j * part.width + 3 * k + c]);
      if (Number.isNaN(p[0])) return s > 0.5 && !Number.isNaN(q[0]) ? q : null;
      return Number.isNaN(q[0]) ? (s < 0.5 ? p : null) : add([p[0] * (1 - s), p[1] * (1 - s), p[2] * (1 - s)], q, s);
    }
    row(track, t) { // of the nearest row of the grid
      const part = this.tracks[track], i = Math.round(this.index(t));
      return part ? Array.from(part.values.subarray(i * part.width, (i + 1) * part.width)) : null;
    }
    wrong(t) { return this.untrusted.some(([from, to]) => t >= from && t <= to); }
    colour(t) { return this.wrong(t) ? "untrusted" : this.hidden(t) >= 0 ? "recovered" : "seen"; }
    hidden(t) { return this.gaps.findIndex(([from, to]) => t >= from && t <= to); }
    end_point(t) {
      const k = this.names.indexOf(this.tip);
      return k >= 0 ? this.at("joints", k, t) : this.at("sensor", 0, t);
    }
    chain(track, t) { return this.names.map((_, k) => this.at(track, k, t)); }
  }

  function player(box) {
    const { view, arms: plain, axes, instants } = JSON.parse(box.querySelector('script[type="application/json"]').textContent);
    const arms = plain.map((each) => new Arm(each));
    const from = Math.min(...arms.map((arm) => arm.start)), to = Math.max(...arms.map((arm) => arm.end));
    const several = arms.length > 1;
    const gaps = arms.flatMap((arm) => arm.gaps.map(([start, end]) => [start, end, several ? arm.name + ", " : ""]));
    gaps.sort((p, q) => p[0] - q[0]);
    const space = new View3D(box, view);
    const find = (name) => box.querySelector(`[data-do="${name}"]`);
    const slider = find("seek"), words = box.querySelector(".now"), play = find("play"), speed = find("speed");
    const shown = (name) => { const input = box.querySelector(`input[value="${name}"]`); return !input || input.checked; };
    let t = from, playing = false, last = 0;

    Object.assign(slider, { min: from, max: to, step: "any" });
    const marks = box.querySelector(".marks");
    for (const [start, end] of gaps) {
      const mark = document.createElement("i");
      mark.style.left = (100 * (start - from)) / (to - from || 1) + "%";
      mark.style.width = (100 * (end - start)) / (to - from || 1) + "%";
      marks.appendChild(mark);
    }
    for (const [start, end] of arms.flatMap((arm) => arm.untrusted)) {
      const mark = document.createElement("i");
      mark.className = "wrong";
      mark.style.left = (100 * (start - from)) / (to - from || 1) + "%";
      mark.style.width = (100 * (end - start)) / (to - from || 1) + "%";
      marks.appendChild(mark);
    }

    function path(v, arm, start, end, width, alpha) {
      const step = Math.max(arm.step, (end - start) / MOST_PATH);
      let run = [], colour = null;
      const flush = () => { if (run.length > 1) v.line(run, colour, width, { alpha }); };
      for (let s = Math.max(start, arm.start); s <= Math.min(end, arm.end); s += step) {
        const p = arm.end_point(s), now = arm.colour(s);
        if (now !== colour) { if (p && colour) run.push(p); flush(); run = []; colour = now; }
        if (p) run.push(p); else { flush(); run = []; }
      }
      flush();
    }

    const WIDTH = 7;
    function skeleton(v, arm, s, alpha = 1) {
      const joints = arm.chain("joints", s), colour = arm.colour(s), there = joints.filter(Boolean);
      v.line(there, colour, WIDTH, { alpha });
      for (const p of there) v.dot(p, colour, 10, "circle", alpha);
      return joints;
    }

    function drawPaths(v, arm) {
      if (shown("path")) {
        const whole = v.paper || to - from < LONG_S;
        path(v, arm, whole ? from : t - AROUND_S, whole ? to : t + AROUND_S, 1.2, 0.4);
      }
      if (shown("trail") && !v.paper) path(v, arm, t - TRAIL_S, t, 3, 0.9);
      if (v.paper) for (const s of instants) skeleton(v, arm, s, 0.3);
    }

    function drawArm(v, arm) {
      if (shown("camera") && arm.tracks.camera) {
        const joints = arm.chain("camera", t), bits = arm.seen ? arm.seen[Math.round(arm.index(t))] : 255;
        joints.forEach((p, k) => {
          if (!p) return;
          const sure = bits & (1 << k), before = joints[k - 1];
          if (before) v.line([before, p], "ghost", 4, { dash: sure && bits & (1 << (k - 1)) ? null : [2, 6], alpha: 0.75 });
          v.dot(p, "ghost", sure ? 8 : 5, sure ? "circle" : "x", 0.75);
        });
      }
      const joints = skeleton(v, arm, t), sensor = arm.at("sensor", 0, t), end = arm.end_point(t);
      if (sensor) {
        const [x, y] = v.project(sensor);
        v.pen.fillStyle = v.colours.ink;
        v.pen.fillRect(x - 5, y - 5, 10, 10);
        v.pen.fillStyle = v.colours.paper;
        v.pen.fillRect(x - 2, y - 2, 4, 4);
      }
      if (shown("reference") && arm.tracks.truth) {
        v.line(arm.chain("truth", t).filter(Boolean), "truth", 2, { dash: [5, 4] });
        const p = arm.at("truth", arm.names.length, t);
        if (p) v.dot(p, "truth", 9, "cross");
      }
      const sigma = arm.row("sigma", t);
      if (shown("sigma") && end && sigma && !Number.isNaN(sigma[0])) v.ellipsoid(end, sigma, REGION, arm.colour(t));
      if (several && (joints[0] || end)) v.text(joints[0] || end, arm.name, "ink", 8, -8);
      return joints;
    }

    space.draw = (v) => {
      v.floor(view.low, axes);
      for (const arm of arms) drawPaths(v, arm);
      for (const arm of arms) drawArm(v, arm);
    };

    function describe() {
      const now = gaps.flatMap(([start, end, of], k) => (t >= start && t <= end ? `${of}gap ${k + 1} of ${gaps.length}` : []));
      const parts = [`${t.toFixed(2)} s of ${to.toFixed(1)} s`];
      if (arms.some((arm) => arm.wrong(t))) parts.push("NOT TO BE TRUSTED");
      parts.push(now.length ? `recovered: ${now.join("; ")}` : "seen by the camera");
      for (const arm of arms) {
        const within = arm.row("within", t);
        if (!within || Number.isNaN(within[0])) continue;
        parts.push(`${several ? arm.name + " " : ""}${arm.tip} within ${(100 * within[0]).toFixed(1)} cm (95 of 100 cases)`);
      }
      words.textContent = parts.join(" · ");
      slider.setAttribute("aria-valuetext", parts.join(", "));
    }

    function show(next, source) {
      t = Math.max(from, Math.min(to, next));
      if (source !== slider) slider.value = t;
      describe();
      space.redraw();
    }
    unocclude.onTime(show);
    const seek = (next, source = box) => unocclude.setTime(Math.max(from, Math.min(to, next)), source);

    function tick(now) {
      if (!playing) return;
      const next = t + (Math.min(now - last, 250) / 1000) * Number(speed.value);
      last = now;
      seek(next);
      if (next >= to) return pause();
      requestAnimationFrame(tick);
    }
    function pause() { playing = false; play.textContent = "▶ Play"; play.setAttribute("aria-pressed", "false"); }
    function start() {
      if (t >= to) seek(from);
      playing = true;
      last = performance.now();
      play.textContent = "❚❚ Pause";
      play.setAttribute("aria-pressed", "true");
      requestAnimationFrame(tick);
    }
    const toggle = () => (playing ? pause() : start());
    /* A little before the gap, so that the eye sees it begin. */
    const LEAD_S = 0.5;
    function jump(direction) {
      const starts = gaps.map(([start]) => Math.max(from, start - LEAD_S));
      const ahead = direction > 0 ? starts.find((s) => s > t + 1e-3) : starts.filter((s) => s < t - (playing ? 0.7 : 1e-3)).pop();
      if (ahead !== undefined) seek(ahead);
    }

    play.addEventListener("click", toggle);
    find("next").addEventListener("click", () => jump(1));
    find("previous").addEventListener("click", () => jump(-1));
    slider.addEventListener("input", () => seek(Number(slider.value), slider));
    for (const input of box.querySelectorAll(".legend input")) input.addEventListener("change", () => space.redraw());
    const views = { camera: space.home, side: { yaw: space.home.yaw + Math.PI / 2, pitch: 0.1 }, behind: { yaw: space.home.yaw + Math.PI, pitch: 0.15 }, top: { yaw: view.top_yaw || 0, pitch: 1.55 } };
    for (const name in views) find(name).addEventListener("click", () => space.look(views[name].yaw, views[name].pitch));
    for (const name of ["next", "previous"]) find(name).disabled = !gaps.length;

    const margin = 0.02 * (to - from);
    unocclude.range = [from - margin, to + margin];

    const visible = () => { const place = box.getBoundingClientRect(); return place.bottom > 0 && place.top < innerHeight; };
    addEventListener("keydown", (e) => {
      const on = e.target.tagName, typing = on === "SELECT" || on === "TEXTAREA" || (on === "INPUT" && e.target !== slider);
      if (typing || e.ctrlKey || e.metaKey || e.altKey || !visible()) return;
      if (on === "BUTTON" && e.key === " ") return; // the button's own key
      const frame = arms[0].step * (e.shiftKey ? Math.max(1, Math.round(1 / arms[0].step)) : 1);
      const keys = { " ": toggle, ArrowRight: () => seek(t + frame), ArrowLeft: () => seek(t - frame),
        g: () => jump(1), G: () => jump(-1), Home: () => seek(from), End: () => seek(to) };
      if ((e.key === "Home" || e.key === "End") && e.target !== slider && e.target !== space.canvas) return;
      if (!keys[e.key]) return;
      e.preventDefault();
      keys[e.key]();
    });
    seek(instants.length ? instants[0] : from);
    space.now();
  }
  addEventListener("DOMContentLoaded", () => document.querySelectorAll(".space.player").forEach(player));
})();
