// What the page says: codes put into words by the catalogue of the reader's language (api/v1/messages), the same one
// that Python reads. To add a language, add its file to daq/words.
const { FluentBundle, FluentNumber, FluentResource } = globalThis.FluentBundle; // vendor/fluent-bundle.js

const KEPT = "kerntemp-language";
let catalogue = { language: "en", languages: ["en"], bundle: new FluentBundle("en") };

export const language = () => catalogue.language;
export const languages = () => catalogue.languages;

// The reader's own variant of the language, for dates and numbers: English may be en-GB.
export const locale = () => variantOf(catalogue.language);
const variantOf = (chosen) => navigator.languages.find((name) => name.startsWith(chosen)) ?? chosen;

// The name of a language in itself: "Deutsch".
export const nameOf = (chosen) => new Intl.DisplayNames([chosen], { type: "language" }).of(chosen);

// Fetches the words of a language, by default of the one this browser prefers; false if nobody answers.
export async function loadWords(chosen = localStorage.getItem(KEPT) ?? navigator.language.split("-")[0]) {
  const answer = await fetch(`api/v1/messages/${encodeURIComponent(chosen)}`).catch(() => null);
  if (answer?.status === 404 && chosen !== "en") return loadWords("en");
  if (!answer?.ok) return false;
  const loaded = await answer.json();
  const bundle = new FluentBundle(variantOf(loaded.language), { useIsolating: false, functions: { NUMBER: numberOrWords, SPAN: span } });
  bundle.addResource(new FluentResource(Object.entries(loaded.messages).map(([code, pattern]) => `${code} = ${pattern}`).join("\n")));
  catalogue = { ...loaded, bundle };
  return true;
}

// What stands for a number that is not known is words already.
function numberOrWords([value], how) {
  if (!(value instanceof FluentNumber)) return value;
  const options = Object.fromEntries(Object.entries(how).map(([name, one]) => [name, one.valueOf()]));
  return new FluentNumber(value.valueOf(), { ...value.opts, ...options });
}

// What stands for a time that is not known is words already.
const span = ([value]) => (value instanceof FluentNumber ? inUnits(value.valueOf()) : value);

// Seconds as people put them, in two units at most; the server's catalogue has the same.
export function inUnits(exact) {
  const seconds = Math.round(exact);
  for (const [large, small, size, part] of [["d", "h", 86400, 3600], ["h", "min", 3600, 60], ["min", "s", 60, 1]]) {
    if (seconds < size) continue;
    const rest = Math.floor((seconds % size) / part);
    return `${Math.floor(seconds / size)} ${large}${rest ? ` ${rest} ${small}` : ""}`;
  }
  return `${seconds} s`;
}

export async function chooseLanguage(chosen) {
  if (await loadWords(chosen)) localStorage.setItem(KEPT, chosen);
}

export const has = (code) => catalogue.bundle.hasMessage(code);

// A number's minus is no hyphen; one within a word or between two numbers is.
const MINUS = /(?<![\p{L}\d.-])-(?=\d)/gu;
// No line ends between a number and its unit.
const UNIT = /(\d) (?=(?:%|°C|K|kPa|mm|ms|s|min|h|d|kB|MB|GB|TB|kJ|kWh|Hz|N|W|J)(?![\p{L}\d]))/gu;
const unbroken = (words) => words.replace(UNIT, "$1\u00a0").replace(MINUS, "−");

// The words of a code; one without any, of a newer server say, is shown with its arguments.
export function text(code, values = {}) {
  const pattern = catalogue.bundle.getMessage(code)?.value;
  const shown = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, argument(value)]));
  if (pattern) return unbroken(catalogue.bundle.formatPattern(pattern, shown, []));
  return unbroken([code, Object.entries(values).map(([name, value]) => `${name} = ${value}`).join(", ")].filter(Boolean).join(": "));
}

// A message of the server in the reader's language; the server's own English where it came without one.
export const inWords = (message, english = "") => (message && has(message.code) ? text(message.code, message.arguments) : english ?? "");

function argument(value) {
  if (Array.isArray(value)) return value.map((one) => (one?.code ? inWords(one, one.code) : String(one))).join(", ");
  if (value?.code) return text(value.code, value.arguments);
  return typeof value === "number" ? new FluentNumber(value, { useGrouping: false }) : String(value);
}

const PLACES = { "panel.top": "page-sensors-top", "panel.bottom": "page-sensors-bottom", core: "page-core-temperature" };

// Where a sensor sits, in words; a place without any stands for itself.
export const placeName = (place) => (PLACES[place] ? text(PLACES[place]) : place);

// A number or header key of a run in words with its unit; one without words, of a header of one's own, stands for itself.
export function numberName(key) {
  const code = `page-number-${key.replaceAll(".", "-")}`;
  if (has(code)) return text(code);
  return has(`page-c-${key}`) ? `${key}: ${text(`page-c-${key}`)} [W/m²K]` : key;
}

// A message about header keys, for whom they are fields of a form: it names each as `names` or a run's numbers do.
export function inFieldWords(message, english, names) {
  const code = AS_FIELD[message?.code] ?? message?.code;
  return inWords(message && { code, arguments: Object.fromEntries(Object.entries(message.arguments).map(([name, value]) => [name, asField(value, names)])) }, english);
}

const AS_FIELD = { "header-number-outside": "page-field-outside", "api-header-not-a-number": "page-field-no-number" };

function asField(value, names) {
  if (Array.isArray(value)) return value.map((one) => asField(one, names));
  if (value?.code) return inFieldWords(value, value.code, names);
  return typeof value === "string" ? names[value] ?? numberName(value).replace(/ \[.*\]$/, "") : value;
}

// What an effect is called, as a heading or in a list, and within a line; one without words stands for itself.
export const effectName = (effect) => (effectCalled(effect) === effect ? effect : capital(effectCalled(effect)));

export function effectCalled(effect) {
  const code = [`effect-${effect}-called`, `page-suspected-${effect.replaceAll(" ", "-")}`].find(has);
  return code ? text(code) : effect;
}

export const capital = (words) => words.slice(0, 1).toUpperCase() + words.slice(1);
