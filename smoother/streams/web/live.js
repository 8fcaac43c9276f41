"use strict";
// The live page: draws the newest answer, counts repetitions, and sends marks.
const at = (id) => document.getElementById(id);
const token = document.body.dataset.token;
const titles = JSON.parse(document.body.dataset.angles);
// What the patient is told, and what to do where there is no arm to show.
const told = {
  seen: "",
  recovered: "The camera does not see the arm; the sensor shows where it is.",
  unsure: "This may be off",
  lost: "Nothing comes that could be shown.",
  wait: "",
};
const say = {
  wait: "Move your arm slowly, all of it in view of the camera. It begins by itself.",
  lost: "No signal just now.",
};
const words = { seen: "seen", recovered: "recovered", unsure: "with care", lost: "lost", wait: "calibrating" };
const state = { shown: null, came: 0, arm: 0, angle: "elbow_flexion", inside: null, count: 0, paused: false, sound: null, events: [] };
// An angle has to leave the target by this before it counts again, degrees.
const LEAVE_DEG = 5;
// Nothing came for so long: the session is over or away, ms.
const AWAY_MS = 2500;

for (const [arm, name, title] of titles) at("angle").add(new Option(title, `${arm} ${name}`));
at("angle").onchange = () => {
  const [arm, name] = at("angle").value.split(" ");
  [state.arm, state.angle, state.inside] = [Number(arm), name, null];
};

async function mark(text) {
  const reply = await fetch(`/mark?token=${encodeURIComponent(token)}`, { method: "POST", body: text });
  return reply.ok;
}
function pressed(id, on) { at(id).setAttribute("aria-pressed", String(on)); }
at("pause").onclick = () => {
  state.paused = !state.paused;
  pressed("pause", state.paused);
  at("pause").textContent = state.paused ? "Go on" : "Pause";
  mark(state.paused ? "pause" : "go on");
};
at("mark").onclick = async () => {
  const taken = await mark(`mark at ${state.count} repetitions`).catch(() => false);
  at("mark").textContent = taken ? "Marked" : "Not taken";
  setTimeout(() => { at("mark").textContent = "Mark"; }, 1200);
};
at("again").onclick = () => { state.count = 0; state.inside = null; at("repetitions").textContent = "0"; };
at("mirror").onclick = () => pressed("mirror", at("mirror").getAttribute("aria-pressed") !== "true");
at("sound").onclick = () => {
  const on = state.sound === null;
  state.sound = on ? new AudioContext() : (state.sound.close(), null);
  pressed("sound", on);
};
function tone() {
  if (state.sound === null) return;
  const tone = state.sound.createOscillator(), level = state.sound.createGain(), now = state.sound.currentTime;
  tone.frequency.value = 880;
  level.gain.setValueAtTime(0.2, now);
  level.gain.exponentialRampToValueAtTime(0.001, now + 0.25);
  tone.connect(level).connect(state.sound.destination);
  tone.start(now);
  tone.stop(now + 0.25);
}

function count(shown) {
  const low = Number(at("low").value), high = Number(at("high").value), angle = shown.angles[state.angle];
  if (!angle || state.paused) return;
  if (angle[1] > (high - low) / 2) return;  // too unsure to tell inside from outside
  const inside = angle[0] >= low && angle[0] <= high;
  if (state.inside === null) {  // who begins inside has not come there
    state.inside = inside;
  } else if (inside && !state.inside) {
    state.inside = true;
    state.count += 1;
    at("repetitions").textContent = String(state.count);
    tone();
  } else if (angle[0] < low - LEAVE_DEG || angle[0] > high + LEAVE_DEG) {
    state.inside = false;
  }
  at("value").classList.toggle("inside", inside);
}

function figures(shown) {
  const angle = shown.angles[state.angle], share = (deg) => `${Math.min(Math.max((deg + 90) / 270, 0), 1) * 100}%`;
  at("value").textContent = angle ? `${Math.round(angle[0])}°` : "–";
  at("sigma").textContent = angle
    ? `± ${angle[1].toFixed(0)}°` + (shown.gap_s ? `, hidden for ${shown.gap_s.toFixed(1)} s` : "") : "";
  if (!angle) at("value").classList.remove("inside");
  at("needle").style.display = angle ? "block" : "none";
  if (angle) at("needle").style.left = share(angle[0]);
  const low = Number(at("low").value), high = Math.max(Number(at("high").value), low);
  at("zone").style.left = share(low);
  at("zone").style.width = `calc(${share(high)} - ${share(low)})`;
  at("light").className = shown.light;
  at("light").textContent = words[shown.light];
  const reason = { unsure: `${told.unsure}: ${shown.why}.`, wait: shown.why };
  at("why").textContent = reason[shown.light] ?? told[shown.light];
  instruct(say[shown.light] || "", !shown.joints.elbow);
  at("events").replaceChildren(...state.events.map((text) => {
    const line = document.createElement("li");
    line.textContent = text;
    return line;
  }));
}

function instruct(text, alone) {
  at("say").textContent = text;
  at("say").classList.toggle("alone", alone);
}

// All arms by one scale; the one whose angle is chosen is in the middle unless there are two.
function draw(arms) {
  const canvas = at("arm"), pen = canvas.getContext("2d"), ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  const middles = arms.map(({ joints }) => joints.shoulder || joints.elbow || joints.wrist).filter(Boolean);
  if (!middles.length) return;
  const mean = (k) => middles.reduce((sum, p) => sum + p[k], 0) / middles.length;
  const centre = middles.length > 1 ? mean(0) : null;
  for (const shown of arms) drawArm(pen, shown, width, height, centre, mean(1));
}

function drawArm(pen, shown, width, height, between, level) {
  const joints = shown.joints, middle = joints.shoulder || joints.elbow || joints.wrist;
  if (!middle) return;
  const side = at("mirror").getAttribute("aria-pressed") === "true" ? -1 : 1;
  const scale = Math.min(width, height) / 1.7;
  const inward = shown.side === "left" ? -0.18 : 0.18;  // to the chest, as the camera sees who faces it
  const centre = between ?? middle[0] + (joints.shoulder ? inward / 2 : 0);
  const place = (p) => [width / 2 + side * scale * (p[0] - centre), height * 0.42 - scale * (p[1] - level)];
  const style = getComputedStyle(document.body), ink = style.color, body = style.getPropertyValue("--body");
  const line = (a, b, thick, colour) => {
    pen.lineWidth = thick; pen.lineCap = "round"; pen.strokeStyle = colour;
    pen.beginPath(); pen.moveTo(...place(a)); pen.lineTo(...place(b)); pen.stroke();
  };
  if (joints.shoulder && joints.elbow) {  // the body, as far as one shoulder shows it
    const s = joints.shoulder, chest = [s[0] + inward, s[1], s[2]];
    line([chest[0], chest[1] - 0.02, 0], [chest[0], chest[1] - 0.5, 0], scale * 0.26, body);
    line(s, chest, scale * 0.07, body);
    pen.fillStyle = body;
    pen.beginPath(); pen.arc(...place([chest[0], chest[1] + 0.24, 0]), scale * 0.1, 0, 7); pen.fill();
  }
  const colours = { seen: "#1d9b50", recovered: "#2b83cf", unsure: "#c99400", lost: "#b3261e", wait: "#888" };
  const colour = colours[shown.light];
  const chain = ["shoulder", "elbow", "wrist", "hand"].filter((name) => joints[name]);
  for (let k = 1; k < chain.length; k += 1) line(joints[chain[k - 1]], joints[chain[k]], scale * 0.055, colour);
  for (const name of chain) {
    pen.fillStyle = ink;
    pen.beginPath(); pen.arc(...place(joints[name]), scale * 0.03, 0, 7); pen.fill();
  }
  const last = joints[chain[chain.length - 1]];
  if (last && shown.sigma_cm) {
    pen.strokeStyle = colour; pen.lineWidth = 1.5; pen.globalAlpha = 0.7;
    pen.beginPath(); pen.arc(...place(last), Math.max(scale * shown.sigma_cm / 50, 2), 0, 7); pen.stroke();
    pen.globalAlpha = 1;
  }
}

let frames = 0;
function frame() {
  if (state.shown && performance.now() - state.came > AWAY_MS) {
    const nothing = { light: "lost", joints: {}, angles: {}, why: "" };
    state.events = [];
    draw([nothing]);
    figures(nothing);
    at("light").textContent = "no connection";
    at("why").textContent = "The session has ended, or was interrupted.";
    instruct("The session has ended.", true);
    state.shown = null;
  }
  if (state.shown) { draw(state.shown); figures(state.shown[state.arm]); frames += 1; document.body.dataset.frames = frames; }
  requestAnimationFrame(frame);
}
const events = new EventSource(`/events?token=${encodeURIComponent(token)}`);
events.onmessage = (message) => {
  const news = JSON.parse(message.data);
  [state.shown, state.events, state.came] = [news.arms, news.events, performance.now()];
  count(state.shown[state.arm]);
};
requestAnimationFrame(frame);
