// Access: the token this browser tab uses. It is kept for the tab's life only.
import { token } from "../api.js";
import { el } from "../dom.js";
import { text } from "../words.js";

export async function show(place) {
  const field = el("input", { type: "password", id: "token", autocomplete: "off", value: token.get(), style: "width:100%" });
  const message = el("p", { role: "status", class: "small" });
  const form = el("form", { class: "stack", style: "max-width:32rem" }, el("label", { for: "token" }, text("page-token")), field,
    el("div", {}, el("button", { class: "button primary" }, text("page-use-token"))), message);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    token.set(field.value.trim());
    message.textContent = text(token.get() ? "page-token-kept" : "page-token-gone");
    location.hash = "#/now";
    location.reload();
  });
  place.append(el("section", { class: "card" }, el("h1", {}, text("page-access")), el("p", { class: "faint" }, text("page-access-hint")), form));
  return null;
}
