"use strict";
// The page of `unocclude app`. All words are in texts.js; all text is set as text, never as markup.

const PLACES = ["forearm_right", "forearm_left", "upper_arm_right", "upper_arm_left", "hand_right", "hand_left", "base"];
const FORMATS = ["csv", "trc", "mot", "c3d", "sto", "parquet", "measures"];
const JOINTS = ["shoulder", "elbow", "wrist", "hand"];
const THINGS = { shoulder: "joint_shoulder", elbow: "joint_elbow", wrist: "joint_wrist", hand: "joint_hand", left: "left", right: "right", accelerometer: "t_acc", gyroscope: "t_gyro", magnetometer: "t_mag", accelerometers: "t_acc", gyroscopes: "t_gyro" };
const BUSY_MS = 400, IDLE_MS = 2500;
const SVG = "http://www.w3.org/2000/svg";
let timer = 0, shownView = null, uploads = null;
const main = document.getElementById("main");

// ---- small helpers

function t(key, values = {}) {
  const text = words[key] ?? key;
  return text.replace(/\{(\w+)\}/g, (whole, name) => (name in values ? values[name] : whole));
}

function h(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key === "value") node.value = value;
    else if (value === true) node.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(key, value);
  }
  node.append(...children.flat(Infinity).filter((each) => each !== null && each !== undefined && each !== ""));
  if (attributes.value !== undefined && tag === "select") node.value = attributes.value;
  return node;
}

function svg(tag, attributes, ...children) {
  const node = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

function say(text) {
  document.getElementById("said").textContent = text;
}

function trouble(text) {
  const place = document.getElementById("trouble");
  place.textContent = text;
  place.hidden = !text;
}

async function ask(method, path, body) {
  let answer;
  try {
    answer = await fetch(path, {
      method,
      headers: body === undefined ? {} : { "content-type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch {
    throw Object.assign(new Error(t("lost")), { lost: true });
  }
  const text = await answer.text();
  let values = {};
  try { values = JSON.parse(text); } catch { values = { error: text.trim() }; }
  if (!answer.ok) throw Object.assign(new Error(values.error || String(answer.status)), { status: answer.status });
  return values;
}

// what a button does: its error is shown, and the page is asked anew
function act(work) {
  return async (event) => {
    event?.preventDefault?.();
    try {
      trouble("");
      await work(event);
    } catch (error) {
      trouble(error.message);
    }
    await refresh();
  };
}

// a number as English writes it
function num(value, digits = 1) {
  return value.toLocaleString("en", { maximumFractionDigits: digits });
}

function size(bytes) {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let at = 0;
  for (; bytes >= 1000 && at < units.length - 1; at++) bytes /= 1000;
  return `${num(bytes, bytes < 10 && at ? 1 : 0)} ${units[at]}`;
}

function select(options, value, onchange, more = {}) {
  return h("select", { value, onchange, ...more }, options.map(([key, name]) => h("option", { value: key }, name)));
}

function labelled(text, control) {
  return h("label", { class: "field" }, h("span", {}, text), control);
}

// a part of the page is made anew only where what it shows has changed, so that focus and input stay
function part(view, key, seen, make) {
  const mark = JSON.stringify(seen);
  const old = view.parts[key];
  if (old && old.mark === mark) return;
  const node = h("div", { "data-part": key }, make());
  if (old) {
    const focused = document.activeElement?.id;
    old.node.replaceWith(node);
    if (focused) document.getElementById(focused)?.focus();
  } else view.root.append(node);
  view.parts[key] = { mark, node };
}

// ---- files that are dropped

async function entriesOf(entry, above) {
  if (entry.isFile) {
    const file = await new Promise((done, failed) => entry.file(done, failed));
    return [{ file, path: above ? `${above}/${file.name}` : file.name }];
  }
  const reader = entry.createReader(), found = [];
  for (;;) {
    const some = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (!some.length) break;
    found.push(...some);
  }
  const path = above ? `${above}/${entry.name}` : entry.name;
  return (await Promise.all(found.map((each) => entriesOf(each, path)))).flat();
}

async function dropped(data) {
  const entries = [...data.items].filter((i) => i.kind === "file").map((i) => i.webkitGetAsEntry?.() || null);
  if (entries.length && entries.every(Boolean)) {
    return (await Promise.all(entries.map((each) => entriesOf(each, "")))).flat();
  }
  return [...data.files].map((file) => ({ file, path: file.name }));
}

function chosen(list) {
  return [...list].map((file) => ({ file, path: file.webkitRelativePath || file.name }));
}

// files by recording: each of several folders is one, all else is one together
function grouped(files) {
  const good = files.filter(({ path }) => !path.split("/").some((each) => each.startsWith(".")));
  const folders = new Map();
  for (const each of good) {
    const steps = each.path.split("/");
    const folder = steps.length > 1 ? steps[0] : "";
    folders.set(folder, [...(folders.get(folder) || []), each]);
  }
  const [only] = folders.keys();
  if (folders.size === 1 && only) {
    // a folder of folders holds a recording in each of them
    const inner = good.map((each) => ({ ...each, path: each.path.slice(only.length + 1) }));
    if (inner.length && inner.every(({ path }) => path.includes("/"))) return grouped(inner);
  }
  return [...folders].map(([name, some]) => ({ name: name || stem(some[0].file.name), files: some }));
}

function stem(name) {
  return name.replace(/\.[^.]*$/, "");
}

function plain(path, taken) {
  const steps = path.split("/").map((each) => each.replace(/[\\:*?"<>|]/g, "_"));
  let name = steps.at(-1);
  for (let n = 2; taken.has(name.toLowerCase()); n++) name = n <= steps.length ? steps.slice(-n).join("_") : `${n}_${steps.at(-1)}`;
  taken.add(name.toLowerCase());
  return name;
}

async function upload(id, files) {
  const taken = new Set();
  let at = 0;
  for (const { file, path } of files) {
    const name = plain(path, taken);
    at += 1;
    uploads = { id, name, at, n: files.length, share: 0 };
    drawUpload();
    try {
      await put(`/api/recordings/${id}/files/${encodeURIComponent(name)}`, file);
    } catch (error) {
      uploads = null;
      throw new Error(t("upload_failed", { name, why: error.message }));
    }
  }
  uploads = null;
  say(t("uploaded", { n: files.length }));
  await ask("POST", `/api/recordings/${id}/jobs`, { kind: "describe" });
}

function put(path, file) {
  return new Promise((done, failed) => {
    const request = new XMLHttpRequest(); // fetch does not say how far an upload is
    request.open("PUT", path);
    request.upload.onprogress = (event) => {
      if (uploads && event.lengthComputable) uploads.share = event.loaded / event.total;
      drawUpload();
    };
    request.onload = () => {
      if (request.status < 300) return done();
      let why = request.responseText;
      try { why = JSON.parse(why).error; } catch { /* as it came */ }
      failed(new Error(why));
    };
    request.onerror = () => failed(new Error(t("lost")));
    request.send(file);
  });
}

function drawUpload() {
  const place = document.getElementById("upload");
  if (!place) return;
  if (!uploads) return place.replaceChildren();
  const text = t("uploading", uploads);
  let bar = place.querySelector("progress");
  if (!bar) {
    bar = h("progress", { max: 1, "aria-label": text });
    place.replaceChildren(h("p", {}, text), bar);
  }
  place.firstChild.textContent = text;
  bar.setAttribute("aria-label", text);
  bar.value = uploads.share;
}

function dropPlace(small, take) {
  const takeFiles = (event) => act(() => take(chosen(event.target.files)))(event);
  const files = h("input", { type: "file", multiple: true, class: "unseen", tabindex: -1, "aria-hidden": "true", onchange: takeFiles, "data-input": "files" });
  const folder = h("input", { type: "file", multiple: true, webkitdirectory: true, class: "unseen", tabindex: -1, "aria-hidden": "true", onchange: takeFiles, "data-input": "folder" });
  const place = h("div", { class: small ? "drop small" : "drop" },
    h("p", {}, h("strong", {}, t(small ? "drop_more" : "drop_title"))),
    small ? null : h("p", { class: "soft" }, t("drop_hint")),
    h("div", { class: "row" },
      h("button", { type: "button", onclick: () => files.click() }, t("choose_files")),
      h("button", { type: "button", onclick: () => folder.click() }, t("choose_folder"))),
    files, folder, small ? null : h("div", { id: "folders", role: "group" }), h("div", { id: "upload" }));
  place.addEventListener("dragover", (event) => { event.preventDefault(); place.classList.add("over"); });
  place.addEventListener("dragleave", () => place.classList.remove("over"));
  place.addEventListener("drop", (event) => {
    event.preventDefault();
    event.stopPropagation();
    place.classList.remove("over");
    const found = dropped(event.dataTransfer); // before the event ends: its items go with it
    act(async () => take(await found))();
  });
  return place;
}

// ---- the list

const listing = {
  async load() {
    return ask("GET", "/api/state");
  },
  busy(state) {
    return state.recordings.some((each) => each.job?.open);
  },
  draw(view, state) {
    document.title = "unocclude";
    part(view, "head", 0, () => [h("h1", { tabindex: -1 }, t("title")), dropPlace(false, startRecordings)]);
    part(view, "list", state.recordings.map((each) => [each, each.job?.state]), () => recordingTable(view, state));
    part(view, "many", state.recordings.map((r) => [r.id, r.name]), () => manyForm(view, state));
    part(view, "foot", [state.folder, Math.round(state.free_bytes / 1e9), state.templates], () => [
      h("p", { class: "soft small" }, t("folder_is", { folder: state.folder, free: size(state.free_bytes) })),
      state.templates.length ? h("p", { class: "soft small" }, t("templates", { names: state.templates.join(", ") })) : null]);
  },
};

async function startRecordings(files) {
  let groups = grouped(files);
  if (!groups.length) return;
  if (groups.length > 1 && !(await areSeveral(groups))) {
    groups = [{ name: files[0].path.split("/")[0], files: groups.flatMap((each) => each.files) }];
  }
  let last = "";
  for (const { name, files: some } of groups) {
    last = (await ask("POST", "/api/recordings", { name })).id;
    if (groups.length === 1) location.hash = `#/r/${last}`;
    await upload(last, some);
  }
}

// whether folders are a recording each, or together one (a folder for each device): asked, since no rule can tell
function areSeveral(groups) {
  const place = document.getElementById("folders"), n = groups.length;
  return new Promise((done) => {
    const answer = (id, several) => h("button", { type: "button", id, onclick: () => { place.replaceChildren(); done(several); } }, t(id, { n }));
    place.replaceChildren(h("p", {}, t("folders_are", { n, names: groups.map((each) => each.name).join(", ") })),
      h("div", { class: "row" }, answer("folders_several", true), answer("folders_one", false)));
    place.querySelector("button").focus();
  });
}

function recordingTable(view, state) {
  if (!state.recordings.length) return h("p", { class: "soft" }, t("none_yet"));
  const heads = ["col_pick", "col_name", "col_person", "col_date", "col_verdict"];
  view.picked ??= new Set();
  const rows = [...state.recordings].sort((a, b) => b.created_s - a.created_s).map((each) => h("tr", {},
    h("td", { "data-head": t("col_pick") }, h("input", {
      type: "checkbox", id: `pick-${each.id}`, "aria-label": t("pick", { name: each.name }), checked: view.picked.has(each.id),
      onchange: (event) => (event.target.checked ? view.picked.add(each.id) : view.picked.delete(each.id)),
    })),
    h("td", { "data-head": t("col_name") }, h("a", { href: `#/r/${each.id}` }, each.name)),
    h("td", { "data-head": t("col_person") }, each.person),
    h("td", { "data-head": t("col_date") }, each.date),
    h("td", { "data-head": t("col_verdict") }, verdictChip(each), each.verdict && each.verdict !== "Usable." ? h("div", { class: "small soft" }, each.verdict) : null)));
  return h("div", { class: "wide" }, h("table", { class: "list" },
    h("thead", {}, h("tr", {}, heads.map((each) => h("th", { scope: "col" }, t(each))))), h("tbody", {}, rows)));
}

function verdictChip(about) {
  const state = about.job?.state;
  if (state === "running" || state === "waiting") return h("span", { class: "chip plain" }, t(`state_${state}`));
  if (about.recovered) return trustChip(about.trusted, about.verdict);
  const word = ["failed", "held", "cancelled", "stopped"].includes(state) ? state : "new";
  return h("span", { class: `chip ${word === "new" ? "plain" : word === "failed" ? "bad" : "care"}` }, t(`state_${word}`));
}

function trustChip(trusted, verdict) {
  if (trusted === false) return h("span", { class: "chip bad" }, t("untrusted"));
  const care = /with care/i.test(verdict || "") || trusted === null;
  return h("span", { class: care ? "chip care" : "chip good" }, t(care ? "care" : "usable"));
}

function manyForm(view, state) {
  if (!state.recordings.length) return null;
  const like = select([["", t("like_none")], ...state.recordings.map((each) => [each.id, each.name])], "", null, { id: "like" });
  return h("section", { class: "step" },
    h("div", { class: "row" }, labelled(t("like"), like),
      h("button", { type: "button", id: "batch", onclick: act(async () => {
        const answer = await ask("POST", "/api/batch", { ids: [...(view.picked || [])], like: like.value || null });
        say(t("batch_begun", { n: answer.begun }));
        if (answer.refused.length) throw new Error(answer.refused.join(" "));
      }) }, t("batch"))));
}

// ---- one recording

const one = {
  async load(view) {
    const about = await ask("GET", `/api/recordings/${view.id}`);
    const seen = JSON.stringify([about.looked_ns, about.looked_at]);
    if (about.looked_at.length && view.seen !== seen) {
      view.streams = (await ask("GET", `/api/recordings/${view.id}/streams`)).files;
      view.seen = seen;
    }
    if (!about.looked_at.length) view.streams = [];
    return about;
  },
  busy(about) {
    return Boolean(about.job?.open);
  },
  draw(view, about) {
    document.title = `${about.name} - unocclude`;
    view.revision = Math.max(view.revision ?? 0, about.revision); // an answer may have been overtaken
    const open = Boolean(about.job?.open);
    part(view, "head", about.name, () => [
      h("p", {}, h("a", { href: "#/" }, t("back"))), h("h1", { tabindex: -1 }, about.name)]);
    part(view, "job", jobSeen(about.job), () => jobBox(view, about));
    if (about.job?.open) moveBar(view, about.job);
    const ready = !open && !about.result && about.looked_at.length > 0 && about.job?.state !== "held";
    part(view, "next", [ready, Boolean(view.streams?.length), about.camera_video], () => (ready && isComplete(view.streams, about.camera_video)
      ? h("p", {}, h("button", { type: "button", id: "next", class: "first", onclick: () => document.getElementById("recover").click() }, t("recover"))) : null));
    part(view, "about", [about.name, about.person, about.date, about.own_date, about.revision, open], () => aboutForm(view, about, open));
    part(view, "files", [about.dropped, open], () => filesSection(view, about, open));
    part(view, "streams", [view.seen, about.choices, about.proposals, about.camera_video, about.looked_at.length, open], () => streamsSection(view, about, open));
    part(view, "check", [about.check, about.choices.remedy, about.revision, open, about.dropped.length], () => checkSection(view, about, open));
    part(view, "recover", [about.result, about.outdated, about.job?.state === "held", open, about.dropped.length], () => recoverSection(view, about, open));
    part(view, "report", [about.report && about.result, about.name, about.report_at], () => reportSection(view, about));
    if (view.working === "recover" && about.job?.state === "held") document.getElementById("check-step")?.scrollIntoView();
    if (view.working === "recover" && about.job?.state === "done") document.getElementById("report-step")?.scrollIntoView();
    view.working = open ? about.job.kind : "";
    part(view, "export", [Boolean(about.result), about.exports, about.downloads, open], () => exportSection(view, about, open));
  },
};

function repeat(view, about) {
  const kind = about.job.kind;
  return ask("POST", `/api/recordings/${view.id}/jobs`, { kind, formats: view.formats || ["csv"] });
}

function jobSeen(job) {
  return job && [job.number, job.state, job.state === "running" ? job.step : 0];
}

function jobBox(view, about) {
  const job = about.job;
  if (!job) return null;
  const name = t(`step_${job.step_name.split(" ")[0]}`);
  if (job.open) {
    const text = job.state === "waiting" ? t("waiting") : t("step_of", { at: job.step + 1, n: job.steps, what: name });
    say(text);
    return h("section", { class: "step working" }, h("p", { id: "doing" }, text),
      h("progress", { id: "bar", max: 1, "aria-label": text }), h("p", { class: "soft small", id: "detail" }),
      h("button", { type: "button", id: "cancel", onclick: act(() => ask("POST", `/api/recordings/${view.id}/cancel`)) }, t("cancel")));
  }
  const printed = job.printed ? h("details", {}, h("summary", {}, t("printed")), h("pre", { tabindex: 0 }, job.printed)) : null;
  if (job.state === "done") {
    const bad = job.kind === "describe" && about.unread.length ? `${about.unread.join(", ")}: ${t("unknown_file")}` : "";
    say(bad || t("job_done"));
    return bad ? h("section", { class: "step" }, h("p", { class: "said", id: "ended" }, bad), printed) : printed;
  }
  const text = job.state === "held" ? t("held") : t(`job_${job.state}`, { why: job.sentence });
  say(text);
  return h("section", { class: "step" }, h("p", { class: job.state === "failed" ? "said" : "said care", id: "ended" }, text),
    job.state === "held" ? null : h("button", { type: "button", id: "repeat", onclick: act(() => repeat(view, about)) }, t("repeat")), printed);
}

function moveBar(view, job) {
  const bar = document.getElementById("bar"), detail = document.getElementById("detail");
  if (!bar) return;
  if (job.share >= 0) bar.value = Math.max(job.share, 0.01);
  else bar.removeAttribute("value");
  detail.textContent = job.share >= 0 ? `${Math.round(100 * job.share)} % ${job.text}` : "";
}

// one after the other, each with what this page has seen last
function change(view, wish) {
  const send = async () => {
    view.revision = (await ask("PATCH", `/api/recordings/${view.id}`, { revision: view.revision, ...wish })).revision;
  };
  view.changing = (view.changing || Promise.resolve()).then(send, send);
  return view.changing;
}

function aboutForm(view, about, open) {
  const field = (key, value, more = {}) => labelled(t(`f_${key}`), h("input", { id: `f-${key}`, value, maxlength: 200, disabled: open, ...more }));
  return h("section", { class: "step" }, h("h2", {}, t("about")),
    h("form", { class: "row", onsubmit: act(async (event) => {
      const value = (key) => event.target.querySelector(`#f-${key}`).value;
      await change(view, { name: value("name"), person: value("person"), date: value("date") });
      say(t("saved"));
    }) },
    field("name", about.name, { required: true }), field("person", about.person),
    field("date", about.date, { type: "date" }),
    h("button", { disabled: open }, t("save")),
    h("button", { type: "button", class: "quiet", disabled: open, onclick: act(async () => {
      if (!confirm(t("remove_sure"))) return;
      await ask("DELETE", `/api/recordings/${view.id}`);
      location.hash = "#/";
    }) }, t("remove_recording"))));
}

function filesSection(view, about, open) {
  const rows = about.dropped.map((each) => h("li", {}, h("span", {}, each.name), h("span", { class: "soft small" }, size(each.bytes)),
    h("button", { type: "button", class: "quiet", disabled: open, "aria-label": t("remove_file", { name: each.name }),
      onclick: act(async () => {
        const left = await ask("DELETE", `/api/recordings/${view.id}/files/${encodeURIComponent(each.name)}`);
        if (left.dropped.length) await ask("POST", `/api/recordings/${view.id}/jobs`, { kind: "describe" });
      }) }, t("remove"))));
  return h("section", { class: "step" }, h("h2", {}, t("s_files")), h("ul", { class: "files" }, rows),
    dropPlace(true, (files) => upload(view.id, files.filter(({ path }) => !path.split("/").some((s) => s.startsWith("."))))));
}

function isComplete(files, film) {
  const kinds = files.flatMap((each) => each.streams.map((stream) => stream.kind));
  const seen = kinds.includes("skeleton") || (film?.model && film.installed);
  return files.some((each) => each.kind === "description") || (seen && kinds.includes("imu"));
}

function streamsSection(view, about, open) {
  const look = h("button", { type: "button", disabled: open || !about.dropped.length, onclick: act(() => ask("POST", `/api/recordings/${view.id}/jobs`, { kind: "describe" })) }, t("look"));
  const files = view.streams || [];
  if (!files.length) return h("section", { class: "step" }, h("h2", {}, t("s_streams")), h("p", { class: "soft" }, t("not_looked")), look);
  const kinds = files.flatMap((each) => each.streams.map((stream) => stream.kind));
  const described = files.some((each) => each.kind === "description");
  const missing = described ? [] : ["skeleton", "imu"].filter((kind) => !kinds.includes(kind) && !(kind === "skeleton" && about.camera_video));
  return h("section", { class: "step" }, h("h2", {}, t("s_streams")),
    missing.map((kind) => h("p", { class: "said care" }, t(`missing_${kind}`))),
    files.map((each) => fileBox(view, about, each, open)), furtherChoices(view, about, files, open), look);
}

function fileBox(view, about, file, open) {
  const out = about.choices.left_out.includes(file.name);
  const tick = h("label", { class: "tick small" }, h("input", { type: "checkbox", checked: out, disabled: open, id: `out-${file.name}`,
    onchange: act((event) => {
      const others = about.choices.left_out.filter((each) => each !== file.name);
      return change(view, { choices: { left_out: event.target.checked ? [...others, file.name] : others } });
    }) }), " ", t("leave_out"));
  return h("div", { class: "file" },
    h("h3", {}, file.name, " ", file.title ? h("span", { class: "soft" }, file.title) : h("span", { class: "soft" }, t("unknown_file"))),
    file.name === about.camera_video?.file ? filmBox(view, about, open)
      : ["video", "model", "calibration", "description"].includes(file.kind) ? h("p", {}, t(`kind_${file.kind}`)) : null,
    file.error && !file.guess ? h("p", { class: "said" }, file.error) : null,
    out ? null : file.streams.map((stream) => streamBox(view, about, stream, open)),
    file.notes.map((note) => h("p", { class: "soft small" }, note)),
    file.guess && !out ? (file.error ? templateForm(view, file, open) : h("details", { class: "small" }, h("summary", {}, t("t_title")), templateForm(view, file, open))) : null, tick);
}

// the video that is used as the camera: what it needs, and how its pictures are stored
function filmBox(view, about, open) {
  const film = about.camera_video, turns = [0, 90, 180, 270].map((each) => [String(each), t(`turn_${each}`)]);
  return [h("p", {}, t("film_is")),
    film.model ? h("p", { class: "soft small" }, t("film_model", { name: film.model })) : h("p", { class: "said care", id: "film-model" }, t("film_no_model")),
    film.installed ? null : h("p", { class: "said care", id: "film-extra" }, t("film_no_extra")),
    h("div", { class: "row" },
      h("label", { class: "tick" }, h("input", { type: "checkbox", id: "c-mirrored", checked: about.choices.video_mirrored, disabled: open,
        onchange: act((event) => change(view, { choices: { video_mirrored: event.target.checked } })) }), " ", t("film_mirrored")),
      labelled(t("film_turn"), select(turns, String(about.choices.video_turn),
        act((event) => change(view, { choices: { video_turn: Number(event.target.value) } })), { id: "c-turn", disabled: open })))];
}

// a joint or a measure as streams name it ("wrist right", "wrist_right", "accelerometer"), in words
function thing(name) {
  return name.replace(/_/g, " ").split(" ").map((each) => (THINGS[each] ? t(THINGS[each]) : each)).join(" ");
}

// a limb as `match` names it
function limb(joint) {
  const place = joint.replace("wrist", "forearm");
  return t(PLACES.includes(place) ? place : `limb_${place}`);
}

function streamBox(view, about, stream, open) {
  const rate = stream.rate_hz === null ? "?" : num(stream.rate_hz);
  const line = t("stream_line", { count: num(stream.count), rate, length: num(stream.duration_s) });
  const facts = [line, `${t("holds")}: ${stream.holds.map(thing).join(", ")}`, `${t("units")}: ${stream.units || "?"}`];
  let worn = null;
  if (stream.kind === "imu") {
    const proposal = about.proposals[stream.key];
    worn = h("div", { class: "row" }, labelled(t("worn"), select(
      [["", t("worn_motion")], ...PLACES.map((each) => [each, t(each)]), ["-", t("worn_skip")]],
      about.choices.places[stream.key] || "",
      act((event) => change(view, { choices: { places: { ...about.choices.places, [stream.key]: event.target.value } } })),
      { id: `worn-${stream.key}`, disabled: open })),
    proposal ? h("p", { class: "small" }, proposal.joint === "unknown" ? t("proposal_none") : t("proposal", { where: limb(proposal.joint), p: Math.min(Math.round(100 * proposal.probability), 99) })) : null);
  } else {
    facts.push(`${t("axes")}: ${t(`axes_${stream.axes || "open"}`)}`);
    if (stream.body) facts.push(t("person_n", { n: stream.body }));
  }
  return h("div", { class: "stream" },
    h("p", {}, h("strong", {}, t(`kind_${stream.kind}`)), stream.name ? ` ${stream.name}` : "", h("br"), h("span", { class: "soft small" }, facts.join(" | "))),
    h("div", { class: "plots" }, stream.plots.map(drawPlot)), worn);
}

function furtherChoices(view, about, files, open) {
  const choices = about.choices;
  const number = (key, label, value) => labelled(label, h("input", { type: "number", step: "any", id: `c-${key}`, disabled: open, value: value ?? "",
    onchange: act((event) => change(view, { choices: { [key]: event.target.value === "" ? null : Number(event.target.value) } })) }));
  const several = new Set(files.flatMap((each) => each.streams.filter((s) => s.kind === "skeleton").map((s) => s.body))).size > 1;
  return h("details", {}, h("summary", {}, t("more_choices")), h("div", { class: "row" },
    labelled(t("which_arm"), select([["", t("all_arms")], ["left", t("left")], ["right", t("right")]], choices.side,
      act((event) => change(view, { choices: { side: event.target.value } })), { id: "c-side", disabled: open })),
    several || choices.body !== null ? number("body", t("body"), choices.body) : null,
    number("imu_starts_at_s", t("starts_at"), choices.imu_starts_at_s)));
}

// least and largest value in each column, as a band; holes where there is none
function drawPlot(plot) {
  const wide = 360, high = 110, left = 38, right = 6, top = 8, bottom = 22;
  const values = plot.lines.flatMap((line) => [...line.low, ...line.high]).filter((each) => each !== null);
  const end = plot.t_s.length ? plot.t_s.at(-1) + plot.t_s[0] : 0;
  let low = Math.min(...values), top_ = Math.max(...values);
  if (!values.length) [low, top_] = [0, 1];
  const span = top_ - low || 1;
  const x = (s) => left + (s / (end || 1)) * (wide - left - right);
  const y = (value) => top + (1 - (value - low) / span) * (high - top - bottom);
  const label = t("plot_label", { title: thing(plot.title), unit: plot.unit, length: num(end), low: short(low), high: short(top_) });
  const picture = svg("svg", { viewBox: `0 0 ${wide} ${high}`, role: "img", "aria-label": label },
    svg("rect", { class: "frame", x: left, y: top, width: wide - left - right, height: high - top - bottom }));
  for (const line of plot.lines) {
    let run = [], shape = "";
    const close = () => {
      if (run.length) {
        const up = run.map((k) => `${x(plot.t_s[k]).toFixed(1)},${y(line.high[k]).toFixed(1)}`);
        const down = [...run].reverse().map((k) => `${x(plot.t_s[k]).toFixed(1)},${y(line.low[k]).toFixed(1)}`);
        shape += `M${[...up, ...down].join("L")}Z`;
      }
      run = [];
    };
    plot.t_s.forEach((_, k) => (line.low[k] === null ? close() : run.push(k)));
    close();
    picture.append(svg("path", { class: `curve ${line.name}`, d: shape || "M0,0" }));
  }
  const text = (content, at) => { const node = svg("text", at); node.textContent = content; return node; };
  picture.append(text(short(top_), { x: left - 4, y: top + 8, "text-anchor": "end" }), text(short(low), { x: left - 4, y: high - bottom, "text-anchor": "end" }),
    text("0", { x: left, y: high - 7 }), text(`${num(end)} ${t("seconds")}`, { x: wide - right, y: high - 7, "text-anchor": "end" }));
  return h("figure", {}, picture, h("figcaption", {}, `${thing(plot.title)}, ${plot.unit}`, plot.lines.map((line) => h("b", { class: line.name }, line.name))));
}

function short(value) {
  return Math.abs(value) >= 100 ? num(value, 0) : num(Number(value.toPrecision(2)), 6);
}

function checkSection(view, about, open) {
  const check = about.check, remedy = about.choices.remedy;
  return h("section", { class: "step", id: "check-step" }, h("h2", {}, t("s_check")), h("p", { class: "soft" }, t("check_hint")),
    check ? verdictBox(view, about, check, open) : null,
    remedy ? h("p", { class: "said good" }, t("remedy_used", { remedy: remedyWords(remedy) }), " ",
      h("button", { type: "button", class: "quiet", disabled: open, onclick: act(() => change(view, { choices: { remedy: "" } })) }, t("remedy_drop"))) : null,
    h("button", { type: "button", id: "check", disabled: open || !about.dropped.length, onclick: act(() => ask("POST", `/api/recordings/${view.id}/jobs`, { kind: "check" })) }, t("check")));
}

function verdictBox(view, about, verdict, open) {
  const kind = verdict.trusted === false ? "said" : /with care/i.test(verdict.verdict) ? "said care" : "said good";
  const rest = [...new Set([...(verdict.reasons || []), ...(verdict.cautions || [])])].filter((each) => each !== verdict.cause && !verdict.verdict.includes(each));
  return h("div", {}, h("p", {}, trustChip(verdict.trusted, verdict.verdict)),
    verdict.verdict === "Usable." ? null : h("p", { class: kind }, verdict.verdict),
    rest.length ? h("ul", {}, rest.map((each) => h("li", {}, each))) : null,
    verdict.allows?.sentence ? h("p", {}, t("allows", { what: verdict.allows.sentence })) : null,
    (verdict.remedies || []).filter((each) => each !== about.choices.remedy).map((each) => h("p", {}, h("button", { type: "button", class: "remedy", disabled: open,
      onclick: act(async () => {
        await change(view, { choices: { remedy: each } });
        await ask("POST", `/api/recordings/${view.id}/jobs`, { kind: "recover" });
      }) }, t("remedy_use", { remedy: remedyWords(each) })))));
}

function remedyWords(remedy) {
  return remedy.split("--").filter(Boolean).map((each) => {
    const [what, ...rest] = each.trim().split(" ");
    return t(`undo_${what}`, { what: rest.join(" ").split(",").map(thing).join(", ") });
  }).join(", ");
}

function recoverSection(view, about, open) {
  const start = (anyway) => act(() => ask("POST", `/api/recordings/${view.id}/jobs`, { kind: "recover", anyway }));
  const held = about.job?.state === "held";
  return h("section", { class: "step" }, h("h2", {}, t("s_recover")),
    about.result ? verdictBox(view, about, about.result, open) : null,
    about.outdated ? h("p", { class: "said care" }, t("outdated")) : null,
    h("div", { class: "row" },
      h("button", { type: "button", id: "recover", class: "first", disabled: open || !about.dropped.length, onclick: start(false) }, t(about.result ? "recover_again" : "recover")),
      held ? h("button", { type: "button", id: "anyway", disabled: open, onclick: start(true) }, t("recover_anyway")) : null));
}

function reportSection(view, about) {
  const address = `/results/${view.id}/report.html`;
  const title = t("report_title", { name: about.name });
  return h("section", { class: "step", id: "report-step" }, h("h2", {}, t("s_report")),
    about.report && about.result
      ? [h("iframe", { src: address, title, id: "report" }),
        h("p", {}, h("a", { href: address, target: "_blank", rel: "noopener" }, t("report_alone")), " ", h("span", { class: "soft small" }, t("report_print")))]
      : h("p", { class: "soft" }, t("report_none")));
}

function exportSection(view, about, open) {
  const ticks = FORMATS.map((each) => h("label", { class: "tick" }, h("input", { type: "checkbox", value: each, id: `x-${each}`, checked: each === "csv" || about.exports.includes(each), disabled: open || !about.result }), t(`x_${each}`)));
  const names = { csv: "recovered.csv", trc: "recovered.trc", mot: "recovered.mot", c3d: "recovered.c3d", sto: "recovered.sto", parquet: "recovered.parquet", measures: "measures.csv" };
  const links = [...about.downloads.map((each) => [`/results/${view.id}/${each}?download`, each]), ...about.exports.map((each) => [`/results/${view.id}/exports/${names[each]}`, names[each]])];
  return h("section", { class: "step" }, h("h2", {}, t("s_export")), h("p", { class: "soft" }, t("export_hint"), about.result ? "" : ` (${t("first")})`),
    h("form", { onsubmit: act(async (event) => {
      view.formats = [...event.target.querySelectorAll("input:checked")].map((each) => each.value);
      await ask("POST", `/api/recordings/${view.id}/jobs`, { kind: "export", formats: view.formats });
    }) }, h("div", { class: "row" }, ticks, h("button", { id: "export", disabled: open || !about.result }, t("export")))),
    links.length ? h("p", {}, `${t("downloads")}: `, links.flatMap(([href, name], k) => [k ? ", " : "", h("a", { href, download: name }, name)])) : null);
}

// ---- an unknown table

function templateForm(view, file, open) {
  const guess = file.guess, width = guess.rows[0]?.length || guess.names.length;
  const columns = [["", t("t_none")], ...Array.from({ length: width }, (_, k) => {
    const name = guess.names[k] || "", own = name && guess.names.filter((each) => each === name).length === 1;
    return [own ? name : String(k + 1), name || t("t_column", { n: k + 1 })];
  })];
  const asColumn = (value) => (guess.names.includes(value) ? value : Number(value));
  const isLong = Boolean(guess.columns.joint);
  const form = h("form", { class: "template", id: `template-${file.name}` });
  const pick = (key, label, value) => labelled(label, select(columns, value === undefined ? "" : String(value), null, { name: key, disabled: open }));
  const choose = (key, label, options, value) => labelled(label, select(options.map((each) => [each, each]), String(value ?? options[0]), null, { name: key, disabled: open }));
  const box = (title, ...fields) => h("fieldset", {}, h("legend", {}, title), h("div", { class: "grid" }, fields));
  const given = (key) => (guess.kind === "imu" || isLong ? guess.columns[key] : undefined);
  const times = () => box(t("t_time"), pick("t", t("t_time"), guess.columns.t),
    choose("time_unit", t("t_time_unit"), ["s", "ms", "us", "ns", "iso", "counter"], guess.keys.time_unit),
    labelled(t("t_rate"), h("input", { type: "number", step: "any", min: 0, name: "rate_hz", value: guess.keys.rate_hz ?? "", disabled: open })));
  const parts = {
    imu: () => [
      ...[["a", "t_acc"], ["g", "t_gyro"], ["m", "t_mag"]].map(([letter, name]) => box(t(name), "xyz".split("").map((axis) => pick(letter + axis, axis, given(letter + axis))))),
      box(t("t_units"), choose("accelerometer_unit", t("t_acc_unit"), ["m/s^2", "g", "mg"], guess.keys.accelerometer_unit), choose("gyroscope_unit", t("t_gyro_unit"), ["rad/s", "deg/s", "mdps"], guess.keys.gyroscope_unit)), times()],
    skeleton: () => [
      ...["left", "right"].flatMap((side) => JOINTS.map((joint) => box(`${t(`joint_${joint}`)} ${t(side)}`, "xyz".split("").map((axis, k) => pick(`${joint}_${side}.${k}`, axis, (guess.columns[`${joint}_${side}`] || [])[k]))))),
      cameraUnits(), times()],
    rows: () => [box(t("t_columns"), pick("joint", t("t_joint"), given("joint")), ..."xyz".split("").map((axis) => pick(axis, axis, given(axis))), pick("state", t("t_state"), given("state")), pick("body", t("t_body"), given("body"))), cameraUnits(), times()],
  };
  const states = () => Object.entries(guess.keys.states || {}).map(([cell, state]) => labelled(`${t("t_states")}: ${cell}`,
    select(["tracked", "inferred", "not_tracked"].map((each) => [each, each]), state, null, { name: `state=${cell}`, disabled: open })));
  const cameraUnits = () => box(t("t_units"), ...states(), choose("position_unit", t("t_position_unit"), ["m", "cm", "mm"], guess.keys.position_unit),
    labelled(t("t_frame"), select(["kinect", "optical", "zup"].map((each) => [each, t(`axes_${each}`)]), guess.keys.frame || "kinect", null, { name: "frame", disabled: open })));
  const body = h("div");
  const kind = select([["imu", t("kind_imu")], ["skeleton", t("kind_skeleton")], ["rows", `${t("kind_skeleton")}, ${t("t_long")}`]],
    guess.kind === "skeleton" ? (isLong ? "rows" : "skeleton") : "imu", () => body.replaceChildren(...parts[kind.value]()), { name: "kind", disabled: open });
  body.append(...parts[kind.value]());
  form.append(h("div", {}, h("p", {}, h("strong", {}, t("t_title")), " ", h("span", { class: "soft" }, t("t_hint"))),
    guess.unsure.map((each) => h("p", { class: "said care" }, each)),
    file.error ? h("details", { class: "small" }, h("summary", {}, t("why")), h("p", {}, file.error)) : null,
    h("div", { class: "wide", tabindex: 0 }, h("table", { class: "sample" },
      guess.names.length ? h("thead", {}, h("tr", {}, guess.names.map((each) => h("th", { scope: "col" }, each)))) : "",
      h("tbody", {}, guess.rows.map((row) => h("tr", {}, row.map((cell) => h("td", {}, cell))))))),
    h("div", { class: "row" }, labelled(t("t_name"), h("input", { name: "title", value: stem(file.name), maxlength: 100, disabled: open })), labelled(t("t_kind"), kind)),
    body, h("p", {}, h("button", { class: "first keep", disabled: open }, t("t_keep")))));
  form.addEventListener("submit", act(async () => {
    const value = (name) => form.querySelector(`[name="${CSS.escape(name)}"]`)?.value ?? "";
    const out = { columns: {}, keys: {} };
    for (const node of body.querySelectorAll("select, input")) {
      const name = node.name;
      if (name.startsWith("state=")) (out.keys.states ??= {})[name.slice(6)] = node.value;
      if (node.value === "" || name.startsWith("state=") || ["time_unit", "rate_hz", "accelerometer_unit", "gyroscope_unit", "position_unit", "frame"].includes(name)) continue;
      if (name.includes(".")) (out.columns[name.split(".")[0]] ??= []).push(asColumn(node.value));
      else out.columns[name] = asColumn(node.value);
    }
    const keys = kind.value === "imu" ? ["accelerometer_unit", "gyroscope_unit"] : ["position_unit", "frame"];
    for (const key of keys) out.keys[key] = value(key);
    if (value("t")) out.keys.time_unit = value("time_unit");
    if (!value("t") || value("time_unit") === "counter") out.keys.rate_hz = Number(value("rate_hz")) || 100;
    await ask("POST", `/api/recordings/${view.id}/template`, { file: file.name, kind: kind.value === "imu" ? "imu" : "skeleton", title: value("title"), ...out });
  }));
  return form;
}

// ---- which view is shown, and asked anew

function viewOf(hash) {
  const [, id] = hash.match(/^#\/r\/([a-z0-9-]+)$/) || [];
  return { kind: id ? one : listing, id, hash, parts: {}, root: h("div") };
}

async function refresh() {
  clearTimeout(timer);
  const view = shownView;
  let wait = IDLE_MS;
  try {
    const state = await view.kind.load(view);
    if (view !== shownView) return;
    const isNew = !view.root.isConnected;
    view.kind.draw(view, state);
    if (isNew) {
      main.replaceChildren(view.root);
      if (view.moved) view.root.querySelector("h1")?.focus();
    }
    drawUpload();
    if (view.lost) trouble("");
    view.lost = false;
    wait = view.kind.busy(state) ? BUSY_MS : IDLE_MS;
  } catch (error) {
    if (view !== shownView) return;
    view.lost = Boolean(error.lost);
    trouble(error.message);
    if (error.status === 404) main.replaceChildren(h("p", {}, h("a", { href: "#/" }, t("back"))));
  }
  clearTimeout(timer);
  timer = setTimeout(refresh, wait);
  document.documentElement.dataset.drawn = "yes";
}

function show(moved) {
  shownView = viewOf(location.hash);
  shownView.moved = moved;
  trouble("");
  return refresh();
}

history.replaceState(null, "", `/${location.hash}`); // the token is in a cookie now
window.addEventListener("hashchange", () => show(true));
for (const name of ["dragover", "drop"]) window.addEventListener(name, (event) => event.preventDefault());
for (const node of document.querySelectorAll("[data-text]")) node.textContent = t(node.dataset.text);
show(false);
