// What all views share: talking to the API, and putting fresh HTML in place without a jump.

export class Refused extends Error {
  constructor(problem, status) {
    super(problem.detail || problem.title || `The service answered ${status}.`);
    this.problem = problem;
    this.status = status;
  }
}

// Sends a request; returns the answer's JSON, or throws `Refused` with the problem document.
export async function ask(method, address, body, headers = {}) {
  const request = { method, headers: { Accept: "application/json", ...headers } };
  if (body !== undefined) {
    request.body = JSON.stringify(body);
    request.headers["Content-Type"] = "application/json";
  }
  let answer;
  try {
    answer = await fetch(address, request);
  } catch {
    throw new Refused({ detail: "The service does not answer. Is it running?" }, 0);
  }
  const text = await answer.text();
  let value = {};
  try {
    value = text ? JSON.parse(text) : {};
  } catch {
    value = { detail: text.slice(0, 200) };
  }
  if (!answer.ok) throw new Refused(value, answer.status);
  return value;
}

export function key() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

// Says something went wrong, where it happened.
export function complain(where, words) {
  where.querySelector(":scope > .alert.said")?.remove();
  where.append(element("p", { className: "alert said", role: "alert", textContent: words }));
}

// Puts new HTML in place of old, child by child: what did not change stays, with its focus and scroll.
export function morph(old, fresh) {
  const before = [...old.childNodes];
  const after = [...fresh.childNodes];
  after.forEach((node, index) => {
    const there = before[index];
    if (!there) old.append(node);
    else if (there.nodeType !== node.nodeType || there.nodeName !== node.nodeName || keep(there) !== keep(node)) there.replaceWith(node);
    else if (node.nodeType !== Node.ELEMENT_NODE) {
      if (there.data !== node.data) there.data = node.data;
    } else if (!there.isEqualNode(node)) patch(there, node);
  });
  before.slice(after.length).forEach((node) => node.remove());
}

function keep(node) {
  return node.id || "";
}

function patch(there, node) {
  if (there.dataset?.own !== undefined) return; // the script owns what is inside
  if (there.nodeName === "IMG" && node.getAttribute("src") !== there.getAttribute("src")) {
    swap(there, node);
    return;
  }
  for (const { name } of [...there.attributes]) {
    if (!node.hasAttribute(name) && !(there.nodeName === "DETAILS" && name === "open")) there.removeAttribute(name);
  }
  for (const { name, value } of node.attributes) {
    if (there.getAttribute(name) !== value) there.setAttribute(name, value);
  }
  if (there.nodeName === "PROGRESS") there.value = node.value;
  morph(there, node);
}

// Shows the next picture only when it is decoded, so that nothing blinks.
function swap(there, node) {
  const next = node.getAttribute("src");
  if (there.dataset.next === next) return;
  there.dataset.next = next;
  const image = new Image();
  image.src = next;
  image.decode().then(() => {
    if (there.dataset.next !== next) return;
    for (const { name, value } of node.attributes) there.setAttribute(name, value);
    delete there.dataset.next;
  }, () => delete there.dataset.next);
}

// A picture may meet a service that is busy: it is asked for again, each time a little later.
const TRIES = 6;
const failures = new WeakMap();

export function persist(root) {
  const again = (image) => {
    const count = failures.get(image) || 0;
    if (count >= TRIES) return;
    failures.set(image, count + 1);
    const address = image.src;
    setTimeout(() => {
      if (image.isConnected && image.src === address) image.src = address;
    }, 1000 * 1.6 ** count);
  };
  root.addEventListener("error", (event) => {
    if (event.target.nodeName === "IMG") again(event.target);
  }, true);
  for (const image of root.querySelectorAll("img")) if (image.complete && !image.naturalWidth) again(image);
}

export function ready() {
  document.documentElement.classList.add("ready");
}
