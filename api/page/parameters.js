// Parameters of effects in words and with units: English as the API says it (softsensor/effects), here in German.
import { plain } from "./dom.js";
import { language } from "./text.js";

const GERMAN = {
  "panel channels later than platen channels by": "Plattenkanäle später als Heizplattenkanäle um",
  "conductivity of the panel": "Wärmeleitfähigkeit der Platte",
  "rise of the conductivity per 100 K": "Anstieg der Wärmeleitfähigkeit je 100 K",
  "upper contact": "oberer Kontakt",
  "share of the contact still missing at closing": "beim Schließen noch fehlender Anteil des Kontakts",
  "time constant of its growth": "Zeitkonstante seines Anstiegs",
  "the contact grows with the pressure to the power of": "der Kontakt wächst mit dem Druck hoch",
  "faces denser than the middle by": "Deckschichten dichter als die Mitte um",
  "heat lost at the rim, per volume and kelvin above ambient": "am Rand verlorene Wärme je Volumen und Kelvin über Umgebung",
  "heat capacity of the panel": "Wärmekapazität der Platte",
  "rise of the heat capacity per 100 K": "Anstieg der Wärmekapazität je 100 K",
  "plates at the start, above their steady temperature by": "Bleche zu Beginn über ihrer Ruhetemperatur um",
  "water that evaporates": "Wasser, das verdampft",
  "temperature from which it evaporates": "Temperatur, ab der es verdampft",
  "effective emissivity of press and panel": "wirksamer Emissionsgrad von Presse und Platte",
  "thermal resistance of the paper": "Wärmewiderstand des Papiers",
  "heat capacity of the paper": "Wärmekapazität des Papiers",
  "upper platen hotter than its reading by": "obere Heizplatte heißer als gemessen um",
  "lower platen hotter than its reading by": "untere Heizplatte heißer als gemessen um",
  "reaction heat of the resin": "Reaktionswärme des Harzes",
  "share of the press face in the reading": "Anteil der Presse an der Messung",
  "time constant of the panel sensors": "Zeitkonstante der Plattenfühler",
  "heat carried by steam, per volume and kelvin above 100 °C": "vom Dampf getragene Wärme je Volumen und Kelvin über 100 °C",
  "times nominal": "mal Nennwert",
  "% of the value at 20 °C": "% des Werts bei 20 °C",
  "times the lower one": "mal der untere",
  "% of the mean": "% des Mittels",
  "% of dry mass": "% der Trockenmasse",
  "kJ/m² per face": "kJ/m² je Seite",
};

const here = (english) => (language() === "de" ? GERMAN[english] ?? english : english);

// A parameter's words, value and interval in the reader's language; without words its short name stands for itself.
export function told(name, parameter, words) {
  const { words: meaning, factor, unit } = words ?? { words: name.replaceAll("_", " "), factor: 1, unit: "" };
  const value = (v) => (typeof v === "number" ? plain(v * factor) : String(v ?? "–"));
  return {
    words: here(meaning),
    value: Array.isArray(parameter.value) ? parameter.value.join(", ") : value(parameter.value),
    unit: here(unit),
    interval: parameter.ci95 ? `${value(parameter.ci95[0])} … ${value(parameter.ci95[1])}` : "–",
  };
}
