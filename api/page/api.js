// The API as the page sees it: JSON by fetch, events by EventSource. Paths are relative, so a proxy may add a prefix.
import { inWords, text as word } from "./words.js";

const ROOT = "api/v1";
const SILENT_MS = 25000; // the server says something every 10 s; a stream silent for longer has died unnoticed

class Refused extends Error {
  constructor(problem, status) {
    super(inWords(problem.detail_said, problem.detail || problem.title) || `HTTP ${status}`);
    this.status = status;
    this.coded = problem.detail_said;
  }
}

export const token = {
  get: () => sessionStorage.getItem("kerntemp-token") || "",
  set: (value) => value ? sessionStorage.setItem("kerntemp-token", value) : sessionStorage.removeItem("kerntemp-token"),
};

export function url(path, query = {}) {
  const parts = Object.entries(query).filter(([, value]) => value !== undefined && value !== null && value !== "");
  const text = parts.flatMap(([key, value]) => [value].flat().map((one) => `${key}=${encodeURIComponent(one)}`)).join("&");
  return `${ROOT}${path}${text ? `?${text}` : ""}`;
}

export async function get(path, query, options = {}) {
  return request("GET", url(path, query), options);
}

export async function post(path, body) {
  return request("POST", url(path), body === undefined ? {} : { body: JSON.stringify(body) });
}

export async function put(path, body) {
  return request("PUT", `${ROOT}${path}`, { body: JSON.stringify(body) });
}

export async function patch(path, body) {
  return request("PATCH", url(path), { body: JSON.stringify(body) });
}

// A link cannot carry a token: with one, the file is fetched and handed over from memory.
export async function download(event) {
  if (!token.get()) return;
  event.preventDefault();
  const link = event.currentTarget;
  const answer = await fetch(link.href, { headers: { Authorization: `Bearer ${token.get()}` } });
  if (!answer.ok) throw new Refused(await answer.json(), answer.status);
  const named = /filename="([^"]+)"/.exec(answer.headers.get("content-disposition") ?? "");
  const address = URL.createObjectURL(await answer.blob());
  const hidden = document.createElement("a");
  hidden.href = address;
  hidden.download = named ? named[1] : link.download;
  hidden.click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}

async function request(method, target, options) {
  const headers = { Accept: "application/json" };
  if (token.get()) headers.Authorization = `Bearer ${token.get()}`;
  if (options.body) headers["Content-Type"] = "application/json";
  const answer = await fetch(target, { method, headers, body: options.body, signal: options.signal }).catch((error) => {
    throw error.name === "AbortError" ? error : new Refused({ detail: word("page-no-answer") }, 0);
  });
  if (answer.status === 204) return null;
  const text = await answer.text();
  let value = {};
  try { value = JSON.parse(text); } catch { value = { title: text.slice(0, 200) }; }
  if (!answer.ok) throw new Refused(value, answer.status);
  return value;
}

// Work done now and again while the page is looked at: not while its answer is being waited for, unless that has died
// unnoticed. Where answers take longer than `ms`, unanswered questions would pile up and overtake one another.
export function again(work, ms, { hiddenToo = false } = {}) {
  let asked = -Infinity;
  const timer = setInterval(async () => {
    if ((document.hidden && !hiddenToo) || performance.now() - asked < SILENT_MS) return;
    const mine = (asked = performance.now());
    await work().catch(() => { /* the link state says it */ });
    if (asked === mine) asked = -Infinity;
  }, ms);
  return () => clearInterval(timer);
}

// Server-Sent Events over fetch: EventSource cannot send a token. Reconnects by itself and
// catches up with Last-Event-ID; `onState` hears "live" or "lost".
export function follow(handlers, onState) {
  let last = "";
  let stopped = false;
  let control = null;
  let wait = 500;
  const run = async () => {
    while (!stopped) {
      control = new AbortController();
      try {
        const headers = { Accept: "text/event-stream" };
        if (token.get()) headers.Authorization = `Bearer ${token.get()}`;
        if (last) headers["Last-Event-ID"] = last;
        const answer = await fetch(url("/live"), { headers, signal: control.signal, cache: "no-store" });
        if (!answer.ok) throw new Error(`HTTP ${answer.status}`);
        onState("live");
        wait = 500;
        await read(answer.body, control, (event) => {
          if (event.id) last = event.id;
          const handler = handlers[event.name];
          if (handler) handler(JSON.parse(event.data));
        });
      } catch {
        if (stopped) return;
      }
      onState("lost");
      await new Promise((resolve) => setTimeout(resolve, wait));
      wait = Math.min(wait * 2, 5000);
    }
  };
  run();
  return () => { stopped = true; if (control) control.abort(); };
}

async function read(body, control, deliver) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const silence = setTimeout(() => control.abort(), SILENT_MS);
    const { value, done } = await reader.read().finally(() => clearTimeout(silence));
    if (done) return;
    rest += value.replaceAll("\r\n", "\n");
    let end;
    while ((end = rest.indexOf("\n\n")) >= 0) {
      const block = rest.slice(0, end);
      rest = rest.slice(end + 2);
      const event = { name: "message", data: "", id: "" };
      for (const line of block.split("\n")) {
        const [field, text] = [line.slice(0, line.indexOf(":")), line.slice(line.indexOf(":") + 1).trimStart()];
        if (field === "event") event.name = text;
        else if (field === "data") event.data += text;
        else if (field === "id") event.id = text;
      }
      if (event.data) deliver(event);
    }
  }
}
