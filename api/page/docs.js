// The API described from its own OpenAPI document, without a network: routes, parameters, answers, and a try button.
import { el } from "./dom.js";
import { token } from "./api.js";

document.documentElement.dataset.theme = localStorage.getItem("kerntemp-theme") || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
const view = document.getElementById("view");
const described = await (await fetch("api/v1/openapi.json")).json();

view.append(el("section", { class: "card" }, el("h2", {}, `${described.info.title} ${described.info.version}`),
  described.info.description.trim().split("\n\n").map((paragraph) => el("p", {}, paragraph))));

const groups = new Map();
for (const [path, methods] of Object.entries(described.paths)) {
  for (const [method, operation] of Object.entries(methods)) {
    const tag = operation.tags?.[0] ?? "other";
    if (!groups.has(tag)) groups.set(tag, []);
    groups.get(tag).push({ path, method, operation });
  }
}
for (const [tag, operations] of groups) {
  view.append(el("section", { class: "card" }, el("h2", {}, tag), operations.map(operationBlock)));
}
view.append(el("section", { class: "card" }, el("h2", {}, "schemas"), Object.entries(described.components.schemas).map(([name, schema]) =>
  el("details", { id: `schema-${name}` }, el("summary", {}, name), el("p", { class: "small" }, schema.description ?? ""), schemaTable(schema)))));

function operationBlock({ path, method, operation }) {
  const fields = (operation.parameters ?? []).map((parameter) => ({ parameter, input: el("input", { type: "text", "aria-label": parameter.name, placeholder: parameter.required ? "required" : "" }) }));
  const wanted = operation.requestBody?.content?.["application/json"]?.schema;
  const body = wanted && el("textarea", { rows: 5, "aria-label": "body", style: "width:100%;font-family:monospace" });
  if (body) body.value = "{}";
  const output = el("pre", { class: "small scroll", hidden: true, style: "max-height:22rem" });
  const run = async () => {
    let target = path.replace(/^\//, "");
    const query = [];
    for (const { parameter, input } of fields) {
      if (!input.value) continue;
      if (parameter.in === "path") target = target.replace(`{${parameter.name}}`, encodeURIComponent(input.value));
      else if (parameter.in === "query") query.push(`${parameter.name}=${encodeURIComponent(input.value)}`);
    }
    const headers = token.get() ? { Authorization: `Bearer ${token.get()}` } : {};
    if (body) headers["Content-Type"] = "application/json";
    const answer = await fetch(query.length ? `${target}?${query.join("&")}` : target, { method: method.toUpperCase(), headers, body: body?.value });
    const content = (await answer.text()).slice(0, 20000);
    let shown = content;
    try { shown = JSON.stringify(JSON.parse(content), null, 2); } catch { /* not JSON */ }
    output.hidden = false;
    output.textContent = `${answer.status} ${answer.statusText}\n\n${shown}`;
  };
  const answers = Object.entries(operation.responses).map(([status, answer]) => {
    const schema = Object.values(answer.content ?? {})[0]?.schema;
    return el("li", {}, `${status} `, el("span", { class: "faint" }, answer.description, " "), schema?.$ref ? link(schema.$ref) : "");
  });
  return el("details", {}, el("summary", {}, el("code", {}, `${method.toUpperCase()} ${path}`), "  ", operation.summary ?? ""),
    el("div", { class: "stack", style: "padding:.6rem 0 1rem 1rem" }, el("p", {}, operation.description ?? ""),
      fields.length ? el("table", { class: "list" }, fields.map(({ parameter, input }) =>
        el("tr", {}, el("td", {}, el("code", {}, parameter.name)), el("td", { class: "faint small" }, parameter.in), el("td", {}, kind(parameter.schema)), el("td", { class: "small" }, parameter.description ?? ""), el("td", {}, input)))) : "",
      body ? el("div", {}, el("p", { class: "small" }, "body ", kind(wanted)), body) : "",
      el("ul", { class: "small" }, answers),
      path.endsWith("/live") ? "" : el("div", {}, el("button", { type: "button", class: "button", onclick: run }, "Try")), output));
}

function schemaTable(schema) {
  if (!schema.properties) return el("code", {}, kind(schema));
  return el("table", { class: "list" }, Object.entries(schema.properties).map(([name, property]) =>
    el("tr", {}, el("td", {}, el("code", {}, name)), el("td", {}, kind(property)), el("td", { class: "small" }, property.description ?? ""))));
}

function kind(schema) {
  if (!schema) return "";
  if (schema.$ref) return link(schema.$ref);
  if (schema.anyOf) return schema.anyOf.map((part, i) => [i ? " | " : "", kind(part)]).flat();
  if (schema.type === "array") return ["[", kind(schema.items), "]"].flat();
  if (schema.enum) return schema.enum.join(" | ");
  return schema.format ? `${schema.type} (${schema.format})` : schema.type ?? "any";
}

function link(reference) {
  const name = reference.split("/").at(-1);
  return el("a", { href: `#schema-${name}`, onclick: () => { document.getElementById(`schema-${name}`).open = true; } }, name);
}
