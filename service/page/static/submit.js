// The editor: line numbers, faults at their lines, files by digest, and the submission itself.
import { Refused, ask, element, key, ready } from "./common.js";
import { NotJson, lineOf, locate, places } from "./json-lines.js";

const form = document.getElementById("form");
const area = document.getElementById("scene");
const gutter = form.querySelector(".gutter");
const marks = form.querySelector(".marks");
const faults = document.getElementById("faults");
const sending = document.getElementById("sending");
const LINE_PX = 20;
const DIGEST = /^(sha256:)?[0-9a-f]{64}$/;

let attempt = key(); // the same submission sent twice makes one job

function number() {
  const count = area.value.split("\n").length;
  if (Number(gutter.dataset.count) === count) return;
  gutter.dataset.count = count;
  gutter.textContent = Array.from({ length: count }, (_, i) => i + 1).join("\n");
}

function scroll() {
  gutter.scrollTop = area.scrollTop;
  marks.style.transform = `translateY(${-area.scrollTop}px)`;
}

function clear() {
  faults.replaceChildren();
  marks.replaceChildren();
  area.removeAttribute("aria-invalid");
}

// Lists faults `{line, words}`; each leads to its line.
function show(list, head) {
  clear();
  area.setAttribute("aria-invalid", "true");
  const items = list.map(({ line, words, pointer }) => {
    const item = element("li");
    if (line) {
      const go = element("button", { type: "button", textContent: `Line ${line}` });
      go.addEventListener("click", () => goTo(line));
      item.append(go, ": ");
      const mark = element("span");
      mark.style.top = `${(line - 1) * LINE_PX}px`;
      marks.append(mark);
    }
    if (pointer) item.append(element("code", { textContent: pointer }), " ");
    item.append(words);
    return item;
  });
  faults.append(element("p", { className: "bad", textContent: head }), element("ul", { className: "faults" }, ...items));
  const first = list.find(({ line }) => line);
  if (first) goTo(first.line);
  scroll();
}

function goTo(line) {
  const lines = area.value.split("\n");
  const start = lines.slice(0, line - 1).reduce((sum, text) => sum + text.length + 1, 0);
  area.focus();
  area.setSelectionRange(start, start + (lines[line - 1] || "").length);
  area.scrollTop = Math.max(0, (line - 6) * LINE_PX);
}

function figure(name, whole = false) {
  const field = form.elements[name];
  const text = field.value.trim();
  field.removeAttribute("aria-invalid");
  if (!text) return undefined;
  const value = Number(text);
  if (!Number.isFinite(value) || value < 0 || (whole && !Number.isInteger(value))) {
    field.setAttribute("aria-invalid", "true");
    field.focus();
    throw new Refused({ detail: `${field.labels[0].textContent}: ${whole ? "a whole number" : "a number"} is needed, not "${text}".` }, 422);
  }
  return value;
}

function stopRule(given) {
  const stop = { ...given };
  const [spp, seconds, rmse] = [figure("spp", true), figure("seconds"), figure("rmse_percent")];
  if (spp !== undefined) stop.spp = spp;
  if (seconds !== undefined) stop.seconds = seconds;
  if (rmse !== undefined) stop.target_error = { rmse_percent: rmse };
  return Object.keys(stop).length ? stop : undefined;
}

// Uploads the chosen files under their SHA-256; returns name -> digest.
async function upload() {
  const assets = {};
  for (const file of form.elements.files.files) {
    sending.textContent = `Uploading ${file.name}`;
    const bytes = await file.arrayBuffer();
    const hash = await crypto.subtle.digest("SHA-256", bytes);
    const digest = Array.from(new Uint8Array(hash), (byte) => byte.toString(16).padStart(2, "0")).join("");
    const answer = await fetch(`/v1/assets/${digest}`, {
      method: "PUT", body: bytes, headers: { "Content-Type": "application/octet-stream" },
    });
    if (!answer.ok) throw new Refused(await answer.json(), answer.status);
    assets[file.name] = digest;
  }
  return assets;
}

// A scene names files with folders, a browser knows only the last part: matches by that.
function named(document_, assets) {
  const found = { ...assets };
  const walk = (value) => {
    if (Array.isArray(value)) value.forEach(walk);
    else if (value && typeof value === "object") Object.values(value).forEach(walk);
    else if (typeof value === "string" && value.includes("/")) {
      const last = value.slice(value.lastIndexOf("/") + 1);
      if (last in assets && !DIGEST.test(value)) {
        found[value] = assets[last];
        delete found[last];
      }
    }
  };
  walk(document_);
  return found;
}

async function submit() {
  const text = area.value;
  const found = places(text);
  const document_ = JSON.parse(text);
  const sweep = document_ && typeof document_ === "object" && "base" in document_;
  const envelope = sweep || (document_ && typeof document_ === "object" && "scene" in document_);
  const body = envelope ? { ...document_ } : { scene: document_ };
  const stop = stopRule(body.stop);
  if (stop) body.stop = stop;
  const priority = figure("priority", true);
  if (priority !== undefined) body.priority = priority;
  if (form.elements.label.value.trim()) body.label = form.elements.label.value.trim();
  const assets = named(document_, await upload());
  if (Object.keys(assets).length) body.assets = { ...body.assets, ...assets };
  sending.textContent = "Sending";
  try {
    const made = await ask("POST", sweep ? "/v1/sweeps" : "/v1/jobs", body, { "Idempotency-Key": attempt });
    location.assign(made.links.self.replace("/v1/", "/"));
  } catch (error) {
    attempt = key();
    const errors = error.problem?.errors || [];
    if (!errors.length) throw error;
    show(errors.map((fault) => {
      const pointer = envelope ? fault.pointer : fault.pointer.replace(/^\/scene(?=\/|$)/, "");
      const outside = !envelope && !fault.pointer.startsWith("/scene");
      return {
        line: outside ? 0 : lineOf(text, locate(found, pointer)),
        words: fault.message + (fault.suggestion ? ` (${fault.suggestion})` : ""),
        pointer,
      };
    }), `${errors.length === 1 ? "One thing is" : `${errors.length} things are`} wrong; nothing was submitted.`);
  }
}

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  const button = form.querySelector("button[type=submit]");
  button.disabled = true;
  clear();
  try {
    await submit();
  } catch (error) {
    if (error instanceof NotJson) {
      show([{ line: lineOf(area.value, error.at), words: error.message }], "This is not JSON yet; nothing was submitted.");
    } else {
      const remedy = error.problem?.remedy ? ` ${error.problem.remedy}` : "";
      show([{ line: 0, words: error.message + remedy }], "Nothing was submitted.");
    }
  }
  button.disabled = false;
  sending.textContent = "";
});

area.addEventListener("input", () => {
  number();
  clear();
});
area.addEventListener("scroll", scroll);
number();
ready();
