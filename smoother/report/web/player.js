"use strict";
/* The arms in motion: a list of arms on one grid of times each, moved by the time that all plots share. */
(() => {
  const { unpack, add, dot, cross, unit } = View3D;
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

  /* A grey person; where it hides the arm, the arm is drawn before it and shines through. */
  class Person {
    constructor(plain) {
      Object.assign(this, plain);
      this.values = unpack(plain.points);
      this.width = plain.points.offset.length;
    }
    at(t) {
      const x = Math.max(0, Math.min(this.count - 1, (t - this.start) / this.step)), i = Math.floor(x);
      const j = Math.min(i + 1, this.count - 1), s = x - i, points = {};
      this.names.forEach((name, k) => {
        const p = [0, 1, 2].map((c) => this.values[i * this.width + 3 * k + c] * (1 - s) + this.values[j * this.width + 3 * k + c] * s);
        if (!Number.isNaN(p[0])) points[name] = p;
      });
      return points;
    }
    /* Ellipsoids that hide: centre, axes and half lengths. */
    parts(p) {
      const h = this.stature, middle = mean(p.shoulder_left, p.shoulder_right), hips = mean(p.hip_left, p.hip_right);
      const right = unit(add(p.shoulder_right, p.shoulder_left, -1)), up = unit(add(middle, hips, -1));
      const axes = [right, up, cross(right, up)];
      return [
        { at: p.head, axes, half: [0.046 * h, 0.066 * h, 0.056 * h] },
        { at: mean(middle, hips), axes, half: [0.125 * h, 0.17 * h, 0.065 * h] },
      ];
    }
    draw(v, p) {
      const h = this.stature, pen = v.pen;
      const thick = (points, m, colour) => v.line(points, colour, Math.max(2, m * h * v.project(points[0])[3]));
      const hips = [p.hip_left, p.hip_right], shoulders = [p.shoulder_left, p.shoulder_right];
      const other = this.other && p.elbow ? [p["shoulder_" + this.other], p.elbow, p.wrist, p.hand].filter(Boolean) : null;
      const trunk = () => {
        const inner = shoulders.map((q, k) => add(add(q, add(shoulders[1 - k], q, -1), 0.06), add(hips[k], q, -1), 0.03));
        const outline = [inner[0], inner[1], hips[1], hips[0], inner[0], inner[1]];
        v.line(outline, "body", Math.max(2, 0.055 * h * v.project(p.neck)[3]));
        pen.beginPath();
        outline.forEach((q, k) => { const [x, y] = v.project(q); if (k) pen.lineTo(x, y); else pen.moveTo(x, y); });
        pen.fillStyle = v.colour("body");
        pen.fill();
        thick([mean(...shoulders), p.neck, p.head], 0.055, "body");
      };
      const head = () => {
        const [x, y, , k] = v.project(p.head), [a, b] = v.project(add(p.head, add(p.head, p.neck, -1), 1));
        pen.beginPath();
        pen.ellipse(x, y, 0.066 * h * k, 0.05 * h * k, Math.atan2(b - y, a - x), 0, 7);
        pen.fillStyle = v.colour("body");
        pen.fill();
        pen.strokeStyle = v.colours.paper;
        pen.lineWidth = 1.5;
        pen.stroke();
        const nose = v.project(p.nose);
        if (nose[2] > v.project(p.head)[2] - 0.02 * h) v.dot(p.nose, "soft", Math.max(3, 0.016 * h * k));
      };
      const limb = () => { if (other) { thick(other, 0.042, "paper"); thick(other, 0.036, "limb"); } };
      const depth = (q) => v.project(q)[2];
      const steps = [[depth(mean(...hips)), trunk], [depth(p.head), head]];
      if (other) steps.push([depth(other[1]), limb]);
      steps.sort((q, r) => q[0] - r[0]);
      for (const [, step] of steps) step();
    }
  }
  const mean = (a, b) => add([a[0] / 2, a[1] / 2, a[2] / 2], b, 0.5);
  function hidden(v, q, parts) {
    const d = unit(add(add(v.center, v.eye, v.far), q, -1));
    return parts.some(({ at, axes, half }) => {
      const o = add(q, at, -1), p = axes.map((axis, k) => dot(o, axis) / half[k]), e = axes.map((axis, k) => dot(d, axis) / half[k]);
      const a = dot(e, e), b = dot(p, e), c = dot(p, p) - 1, root = b * b - a * c;
      return root > 0 && -b + Math.sqrt(root) > 0;
    });
  }

  function player(box) {
    const { view, arms: plain, axes, instants, people: bodies, pictures } = JSON.parse(box.querySelector('script[type="application/json"]').textContent);
    const arms = plain.map((each) => new Arm(each)), people = (bodies || []).map((each) => new Person(each));
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

    const PIECES = 16, WIDTH = 7;
    function skeleton(v, arm, s, alpha = 1, parts = [], behind = null) {
      const joints = arm.chain("joints", s), colour = arm.colour(s), there = joints.filter(Boolean);
      if (behind === null) v.line(there, colour, WIDTH, { alpha });
      else for (let k = 1; k < there.length; k++) { // what the body hides in one go, the rest in another
        const along = (share) => add(there[k - 1], add(there[k], there[k - 1], -1), share / PIECES);
        let run = [];
        for (let i = 0; i <= PIECES; i++) {
          const mine = i < PIECES && hidden(v, along(i + 0.5), parts) === behind;
          if (mine) run.push(...(run.length ? [] : [along(i)]), along(i + 1));
          else { if (run.length) v.line(run, colour, WIDTH); run = []; }
        }
      }
      for (const p of there) if (behind === null || hidden(v, p, parts) === behind) v.dot(p, colour, 10, "circle", alpha);
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

    function drawArm(v, arm, parts) {
      if (shown("camera") && arm.tracks.camera) {
        const joints = arm.chain("camera", t), bits = arm.seen ? arm.seen[Math.round(arm.index(t))] : 255;
        joints.forEach((p, k) => {
          if (!p) return;
          const sure = bits & (1 << k), before = joints[k - 1];
          if (before) v.line([before, p], "ghost", 4, { dash: sure && bits & (1 << (k - 1)) ? null : [2, 6], alpha: 0.75 });
          v.dot(p, "ghost", sure ? 8 : 5, sure ? "circle" : "x", 0.75);
        });
      }
      const joints = skeleton(v, arm, t, 1, parts, parts.length ? false : null), sensor = arm.at("sensor", 0, t), end = arm.end_point(t);
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
      const upright = people.length && shown("body") ? people.map((each) => [each, each.at(t)]) : [];
      const parts = upright.flatMap(([each, p]) => each.parts(p));
      v.floor(view.low, upright.length && v.w < 560 ? null : axes);
      for (const arm of arms) drawPaths(v, arm);
      if (upright.length) {
        for (const arm of arms) skeleton(v, arm, t, 1, parts, true);
        v.layer(0.72, () => { for (const [each, p] of upright) each.draw(v, p); });
      }
      for (const arm of arms) drawArm(v, arm, parts);
    };

    /* The picture that was taken last. */
    const film = box.querySelector(".film");
    let picture = -1;
    function showFilm() {
      if (!film) return;
      let low = 0, high = pictures.times.length;
      while (low < high) { const k = (low + high) >> 1; if (pictures.times[k] <= t) low = k + 1; else high = k; }
      const next = low - 1 >= 0 && t - pictures.times[low - 1] < pictures.longest ? low - 1 : -1;
      film.hidden = !shown("film");
      film.style.visibility = next < 0 ? "hidden" : "visible";
      if (next >= 0 && next !== picture) film.src = "data:image/jpeg;base64," + pictures.jpeg[next];
      picture = next < 0 ? picture : next;
    }

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
      showFilm();
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
    for (const input of box.querySelectorAll(".legend input")) input.addEventListener("change", () => { showFilm(); space.redraw(); });
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
