"use strict";
/* What is in space, drawn on a canvas without WebGL: it prints, and needs no graphics card.
   Drag turns, two fingers or Ctrl with the wheel come closer, arrows turn by keyboard, a double click resets. */
var View3D = (() => {
  const LIGHT = { ink: "#1b1b1b", soft: "#666", paper: "#fff", faint: "#dfe3e6", seen: "#0072b2",
    recovered: "#d55e00", untrusted: "#b00020", ghost: "#8a8a8a", truth: "#111" };
  const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };

  /* Little-endian int16 in base64, with a scale and one offset per column; the lowest number is "nothing". */
  function unpack({ data, scale, offset }) {
    const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
    const raw = new DataView(bytes.buffer), n = bytes.length / 2, columns = offset.length;
    const values = new Float32Array(n);
    for (let i = 0; i < n; i++) {
      const whole = raw.getInt16(2 * i, true);
      values[i] = whole === -32768 ? NaN : whole * scale + offset[i % columns];
    }
    return values;
  }

  class View3D {
    constructor(box, { up, eye, center, radius, aspect, zoom }) {
      this.canvas = box.querySelector("canvas");
      this.pen = this.canvas.getContext("2d");
      this.up = unit(up);
      const flat = add(eye, this.up, -dot(eye, this.up));
      const beside = Math.abs(this.up[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0];
      this.a = unit(Math.hypot(...flat) > 1e-6 ? flat : cross(this.up, beside));
      this.b = cross(this.up, this.a);
      this.home = { yaw: 0, pitch: Math.asin(Math.max(-1, Math.min(1, dot(unit(eye), this.up)))), zoom: zoom || 1 };
      Object.assign(this, this.home, { center, radius, aspect, paper: false, draw: () => {} });
      this._pointers = new Map();
      this._listen();
    }

    look(yaw, pitch) { Object.assign(this, { yaw, pitch }); this.redraw(); }

    palette() {
      if (this.paper) return LIGHT;
      const css = getComputedStyle(document.documentElement), names = {};
      for (const name in LIGHT) names[name] = css.getPropertyValue("--" + name).trim() || LIGHT[name];
      return names;
    }

    begin() {
      const ratio = this.paper ? 2 : window.devicePixelRatio || 1;
      this.canvas.style.width = this.paper ? "690px" : "100%";
      this.w = this.paper ? 690 : this.canvas.clientWidth || 690;
      this.h = Math.round(Math.min(this.w * (this.w < 560 ? 0.95 : this.aspect), 0.52 * Math.max(window.innerHeight, 620) + (this.paper ? 200 : 0)));
      this.canvas.style.height = this.h + "px";
      this.canvas.width = this.w * ratio;
      this.canvas.height = this.h * ratio;
      this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      this.colours = this.palette();
      this.pen.fillStyle = this.colours.paper;
      this.pen.fillRect(0, 0, this.w, this.h);
      this.pen.font = "12px system-ui, sans-serif";
      this.pen.lineCap = this.pen.lineJoin = "round";
      const [c, s] = [Math.cos(this.yaw), Math.sin(this.yaw)], [cp, sp] = [Math.cos(this.pitch), Math.sin(this.pitch)];
      const level = add([c * this.a[0], c * this.a[1], c * this.a[2]], this.b, s);
      this.eye = unit(add([cp * level[0], cp * level[1], cp * level[2]], this.up, sp));
      this.right = add([c * this.b[0], c * this.b[1], c * this.b[2]], this.a, -s);
      this.top = cross(this.eye, this.right);
      this.far = 3.6 * this.radius;
      this.size = (this.zoom * Math.min(this.w, this.h)) / 2 / this.radius;
    }

    redraw() {
      if (this._waiting) return;
      this._waiting = requestAnimationFrame(() => { this._waiting = 0; this.now(); });
    }

    now() { this.begin(); this.draw(this); }

    project(p) {
      const d = add(p, this.center, -1), depth = dot(d, this.eye);
      const k = (this.size * this.far) / Math.max(this.far - depth, 0.2 * this.far);
      return [this.w / 2 + k * dot(d, this.right), this.h / 2 - k * dot(d, this.top), depth, k];
    }

    colour(name) {
      if (name && name.toLowerCase() === "#111111") return this.colours.truth;
      return this.colours[name] || name || this.colours.ink;
    }

    line(points, colour, width = 1, { dash = null, alpha = 1 } = {}) {
      const pen = this.pen;
      pen.strokeStyle = this.colour(colour);
      pen.lineWidth = width;
      pen.globalAlpha = alpha;
      pen.setLineDash(dash || []);
      pen.beginPath();
      let open = false;
      for (const p of points) {
        if (!p || Number.isNaN(p[0])) { open = false; continue; }
        const [x, y] = this.project(p);
        if (open) pen.lineTo(x, y); else pen.moveTo(x, y);
        open = true;
      }
      pen.stroke();
      pen.setLineDash([]);
      pen.globalAlpha = 1;
    }

    dot(p, colour, size, symbol = "circle", alpha = 1) {
      const [x, y] = this.project(p), pen = this.pen, r = size / 2;
      pen.globalAlpha = alpha;
      pen.fillStyle = pen.strokeStyle = this.colour(colour);
      if (symbol === "x" || symbol === "cross") {
        pen.lineWidth = Math.max(1.5, size / 4);
        pen.beginPath();
        if (symbol === "x") { pen.moveTo(x - r, y - r); pen.lineTo(x + r, y + r); pen.moveTo(x - r, y + r); pen.lineTo(x + r, y - r); }
        else { pen.moveTo(x - r, y); pen.lineTo(x + r, y); pen.moveTo(x, y - r); pen.lineTo(x, y + r); }
        pen.stroke();
      } else if (size < 3.5) pen.fillRect(x - r, y - r, size, size);
      else { pen.beginPath(); pen.arc(x, y, r, 0, 7); pen.fill(); }
      pen.globalAlpha = 1;
    }

    text(p, words, colour, dx = 6, dy = 4) {
      const [x, y] = this.project(p), room = this.w - this.pen.measureText(words).width - 4;
      const at = Math.max(4, Math.min(room, x + dx));
      this.pen.fillStyle = this.colour(colour);
      this.pen.strokeStyle = this.colours.paper;
      this.pen.lineWidth = 3;
      this.pen.strokeText(words, at, y + dy);
      this.pen.fillText(words, at, y + dy);
    }

    /* Outline of the ellipsoid p + factor L ball, L lower triangular (xx, yx, yy, zx, zy, zz). */
    ellipsoid(p, l, factor, colour) {
      const columns = [[l[0], l[1], l[3]], [0, l[2], l[4]], [0, 0, l[5]]];
      const rows = [this.right, this.top].map((axis) => columns.map((column) => dot(column, axis)));
      const [xx, xy, yy] = [dot(rows[0], rows[0]), dot(rows[0], rows[1]), dot(rows[1], rows[1])];
      const mean = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy);
      const [x, y, , k] = this.project(p), pen = this.pen;
      pen.beginPath();
      pen.ellipse(x, y, factor * k * Math.sqrt(mean + apart), factor * k * Math.sqrt(Math.max(mean - apart, 0)),
        -0.5 * Math.atan2(2 * xy, xx - yy), 0, 7);
      pen.fillStyle = pen.strokeStyle = this.colour(colour);
      pen.globalAlpha = 0.22; pen.fill();
      pen.globalAlpha = 0.8; pen.lineWidth = 1; pen.stroke();
      pen.globalAlpha = 1;
    }

    /* A level floor of squares whose size is said, and the axes at its corner. */
    floor(low, axes) {
      const steps = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10];
      const step = steps.find((s) => this.radius / s < 7) || 20, n = Math.ceil(this.radius / step);
      const at = add(this.center, this.up, low - dot(this.center, this.up));
      const [e, f] = [this.a, this.b];
      for (let i = -n; i <= n; i++) {
        for (const [g, k] of [[e, f], [f, e]]) {
          const from = add(add(at, g, i * step), k, -n * step);
          this.line([from, add(from, k, 2 * n * step)], "faint", 1);
        }
      }
      const words = step < 1 ? `squares of ${Math.round(100 * step)} cm` : `squares of ${step} m`;
      this.pen.fillStyle = this.colours.soft;
      this.pen.fillText(words, 10, this.h - 10);
      if (axes) this.triad(add(add(at, e, -n * step), f, -n * step), 1.2 * step, axes);
    }

    triad(at, length, names, ball) { // about a ball only what stands out of it, and is not behind it
      [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach((axis, k) => {
        const tip = add(at, axis, length), from = ball ? add(at, axis, 1.02 * ball) : at;
        if (!ball || !this.hides(ball, from)) this.line([from, tip], "soft", 2);
        if (!ball || !this.hides(ball, tip)) this.text(add(at, axis, 1.08 * length), names[k], "soft", -6);
      });
    }

    hides(ball, p) { // whether a ball about the origin lies before a point
      const eye = add(this.center, this.eye, this.far), d = add(p, eye, -1), l = Math.hypot(...d);
      const along = -dot(eye, d) / l, off = dot(eye, eye) - along * along;
      return off < ball * ball && along - Math.sqrt(ball * ball - off) < l - 1e-6;
    }

    _listen() {
      const c = this.canvas, pointers = this._pointers;
      const spread = () => { const [p, q] = [...pointers.values()]; return Math.hypot(p[0] - q[0], p[1] - q[1]); };
      c.addEventListener("pointerdown", (e) => { pointers.set(e.pointerId, [e.clientX, e.clientY]); c.setPointerCapture(e.pointerId); });
      c.addEventListener("pointermove", (e) => {
        const before = pointers.get(e.pointerId);
        if (!before) return;
        const apart = pointers.size === 2 ? spread() : 0;
        pointers.set(e.pointerId, [e.clientX, e.clientY]);
        if (apart) this.zoom = Math.max(0.3, Math.min(12, (this.zoom * spread()) / apart));
        const share = 1 / pointers.size;
        this.yaw -= share * 0.008 * (e.clientX - before[0]);
        this.pitch = Math.max(-1.55, Math.min(1.55, this.pitch + share * 0.008 * (e.clientY - before[1])));
        this.redraw();
      });
      for (const end of ["pointerup", "pointercancel"]) c.addEventListener(end, (e) => pointers.delete(e.pointerId));
      c.addEventListener("wheel", (e) => {
        if (!e.ctrlKey && document.activeElement !== c) return; // else the page would not scroll on
        e.preventDefault();
        this.zoom = Math.max(0.3, Math.min(12, this.zoom * Math.exp(-0.0015 * e.deltaY)));
        this.redraw();
      }, { passive: false });
      c.addEventListener("dblclick", () => { Object.assign(this, this.home); this.redraw(); });
      new ResizeObserver(() => { if (c.clientWidth !== this.w) this.redraw(); }).observe(c);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
      const paper = (on) => () => { this.paper = on; this.now(); };
      unocclude.beforePrint.push(paper(true));
      unocclude.afterPrint.push(paper(false));
    }
  }

  return Object.assign(View3D, { unpack, add, dot, cross, unit });
})();
