// What the server says in English, in German: patterns for the sentences a person at the press sees.
// What matches none stays English; the journal keeps the wording the log files have.
import { measurement } from "./measurements.js";
import { reason } from "./reasons.js";
import { refusal } from "./refusals.js";
import { language, text } from "./text.js";

const PATTERNS = [
  [/^([\w@.-]+): never seen; start kerntemp (\w+)$/, "$1: noch nie gesehen; starten Sie kerntemp $2"],
  [/^([\w@.-]+): silent for (\d+) s; start kerntemp (\w+)$/, "$1: seit $2 s stumm; starten Sie kerntemp $3"],
  [/^logger (.+) answers again$/, "Messgerät $1 antwortet wieder"],
  [/^the clock of this machine was set by (.+) s; .*$/, "die Uhr dieses Rechners wurde um $1 s gestellt; Zeiten innerhalb einer Pressung sind nicht betroffen"],
  [/^(\w+) has changed by (.+) since run (.+) \(noticed at (.+)\): .*$/, "$1 hat sich seit Pressung $3 um $2 geändert (bemerkt bei $4): prüfen Sie, was davor an der Presse getan wurde"],
  [/^run (.+) was interrupted; its data are kept$/, "Pressung $1 wurde unterbrochen; ihre Daten sind erhalten"],
  [/^run (.+): (.+) changed$/, "Pressung $1: $2 geändert"],
  [/^model (.+) promoted$/, "Modell $1 eingesetzt"],
  [/^the live sensor takes model (.+)$/, "der Live-Sensor nimmt Modell $1"],
  [/^token (.+) created, scope read$/, "Schlüssel $1 angelegt, darf lesen"],
  [/^token (.+) created, scope write$/, "Schlüssel $1 angelegt, darf ändern"],
  [/^token (.+) revoked$/, "Schlüssel $1 zurückgezogen"],
  [/^recording (.+); while the store is away scans wait in memory, enough for (.+) h$/, "Aufzeichnung von $1; ist der Speicher nicht erreichbar, warten Messzeilen im Arbeitsspeicher, genug für $2 h"],
  [/^recording (.+); while the store is away scans wait in (.+), enough for (.+) h$/, "Aufzeichnung von $1; ist der Speicher nicht erreichbar, warten Messzeilen in $2, genug für $3 h"],
  [/^recording (?!goes|ends)(.+)$/, "Aufzeichnung von $1"],
  [/^recording ends$/, "Aufzeichnung endet"],
  [/^following (?!the)(.+)$/, "folgt $1"],
  [/^(\d+) scans recorded$/, "$1 Messzeilen aufgezeichnet"],
  [/^never seen$/, "noch nie gesehen"],
  [/^no panel in the press$/, "keine Platte in der Presse"],
  [/^the live sensor has said nothing for (.+) s$/, "der Live-Sensor schweigt seit $1 s"],
  [/^platen reading missing$/, "Heizplattenmessung fehlt"],
  [/^model not valid$/, "Modell nicht gültig"],
  [/^model not valid: sensors read (.+) °C where the header has the panel start at (.+) °C$/, "Modell nicht gültig: die Fühler zeigen $1 °C, laut Kopfdaten beginnt die Platte bei $2 °C"],
  [/^model not valid: the run begins in the closed press$/, "Modell nicht gültig: die Aufzeichnung beginnt in der geschlossenen Presse"],
  [/^model not valid: the press has closed again on the same panel$/, "Modell nicht gültig: die Presse hat sich über derselben Platte noch einmal geschlossen"],
  [/^model not valid: the press closed while nothing was heard of it for long$/, "Modell nicht gültig: die Presse schloss, während lange nichts gemessen wurde"],
  [/^model not valid: both faces have leapt while they were not heard$/, "Modell nicht gültig: beide Seiten sind gesprungen, während sie nicht gemessen wurden"],
  [/^model not valid: platen temperatures were missing when the panel came to lie in the press$/, "Modell nicht gültig: die Heizplattenmessung fehlte, als die Platte eingelegt wurde"],
  [/^core not observable: no sensor of the lower face shows whether a panel lies in the press$/, "Kern nicht bestimmbar: kein Fühler der Unterseite zeigt, ob eine Platte in der Presse liegt"],
  [/^core not observable: nothing has shown when the panel came$/, "Kern nicht bestimmbar: nichts hat gezeigt, wann die Platte kam"],
  [/^model not valid: the run begins with the panel on the hot plate$/, "Modell nicht gültig: die Aufzeichnung beginnt mit der Platte auf der heißen Heizplatte"],
  [/^model not valid: for long no sensor has shown whether the panel still lies in the open press$/, "Modell nicht gültig: seit Langem zeigt kein Fühler, ob die Platte noch in der offenen Presse liegt"],
  [/^model not valid: faces far colder than those of the panel that was pressed; another one may lie there$/, "Modell nicht gültig: die Flächen sind viel kälter als die der gepressten Platte; es kann eine andere dort liegen"],
  [/^model not valid: no fresh panel starts at (.+) °C, as the header has it$/, "Modell nicht gültig: keine frische Platte beginnt bei $1 °C, wie es in den Kopfdaten steht"],
  [/^core not observable: band wider than (.+) K to either side$/, "Kern nicht bestimmbar: Band breiter als $1 K zu jeder Seite"],
  [/^press state unknown$/, "Pressenzustand unbekannt"],
  [/^core will peak at (.+) °C, above the limit of (.+) °C$/, "der Kern erreicht noch $1 °C, über der Grenze von $2 °C"],
  [/^core will peak at (.+) °C even if opened now, above (.+) °C$/, "der Kern erreicht $1 °C, auch wenn jetzt geöffnet wird, über $2 °C"],
  [/^core may pass (.+) °C in (.+) s: open the press$/, "der Kern kann in $2 s $1 °C überschreiten: Presse öffnen"],
  [/^saves (.+) of (.+) K on runs left out$/, "spart $1 von $2 K auf ausgelassenen Pressungen"],
  [/^found by comparison with the channels beside it, and left out$/, "durch Vergleich mit den Kanälen daneben gefunden und weggelassen"],
  [/^None needed: core thermocouples confirm it \((.+) K off before, (.+) K after\)\.$/, "Keine nötig: Kernfühler bestätigen es (vorher $1 K daneben, nachher $2 K)."],
  [/^Measure the panel's conductivity and heat capacity: faces fit, but core thermocouples are off by (.+) K, .*$/, "Messen Sie Wärmeleitfähigkeit und Wärmekapazität der Platte: die Seiten passen, aber die Kernfühler liegen $1 K daneben, also stimmt etwas nicht, das die Seiten nicht zeigen."],
  [/^None needed; .*$/, "Keine nötig; ein Kernfühler in einer Opferplatte im Monat würde den Kern bestätigen."],
  [/^Press at least (\d+) more panels, .* below (\d+) runs .*$/, "Pressen Sie mindestens $1 weitere Platten, mit verschiedenen Presszeiten und möglichst Dicken: unter $2 Pressungen ist Zufall von einer Ursache nicht zu trennen."],
  [/^Press three sacrificial panels with a core thermocouple .*$/, "Pressen Sie drei Opferplatten mit Kernfühler und sehen Sie die aufgeführten Zeiten und Stellen an."],
];

export const effectName = (effect) => { const key = `effect_${effect.replaceAll(" ", "_")}`; return text(key) === key ? effect : text(key); };

// A decimal point before a unit becomes a comma; addresses and versions keep theirs.
const commas = (german) => german.replace(/(\d)\.(\d+)(?=\s?(?:[Khs]\b|°C|%|mm\b|min\b|W\/)| von )/g, "$1,$2");

export function sentence(english) {
  return language() !== "de" || !english ? named(english ?? "") : commas(german(english));
}

// English with effects by what they are called where a sentence begins with their short names.
function named(english) {
  return english.replace(/^[\w+ ]+(?=: residual )/, (names) => names.split(" + ").map(effectName).join(" + "))
    .replace(/^To tell (.+?)(?=: )/, (_, names) => `To tell ${names.split(" from ").map((n) => `“${effectName(n)}”`).join(" from ")}`);
}

// What a cause is worth that hardly lowers the residual (softsensor/diagnosis_words.py).
function hardly([, gain, before, better, runs, coefficient, bodies, percent, core, when]) {
  const named = better ? `; benannt, weil ${better} von ${runs} Pressungen, jede einmal ausgelassen, damit besser getroffen werden` : "";
  const words = text(`c_${coefficient}`) === `c_${coefficient}` ? bodies : text(`c_${coefficient}`);
  const moved = coefficient ? `${coefficient} (${words}) um ${percent} %` : "keinen Koeffizienten über den Zufall hinaus";
  const moment = when === "at the end of a run" ? "am Ende einer Pressung" : "beim Öffnen der Presse";
  return `senkt das Residuum auf ausgelassenen Pressungen kaum (${gain} von ${before} K)${named}; es ändert ${moved}${core ? `, und den Kern um ${core} K ${moment}` : ""}`.replaceAll(/(\d)\.(\d)/g, "$1,$2");
}

function german(english) {
  for (const [pattern, told] of PATTERNS) if (pattern.test(english)) return english.replace(pattern, told);
  const lost = /^logger (.+) does not answer: (.+); recording goes on without it, trying again$/.exec(english);
  if (lost) return `Messgerät ${lost[1]} antwortet nicht: ${sentence(lost[2])}; die Aufzeichnung läuft ohne es weiter und versucht es wieder`;
  const why = reason(english, effectName);
  if (why) return why;
  const refused = refusal(english, sentence, text);
  if (refused) return refused;
  const worth = /^hardly lowers the residual on runs left out \((.+) of (.+) K\)(?:; named because (\d+) of (\d+) runs, each left out in turn, are met better with it)?; it moves (?:no coefficient by more than chance|(\S+) \((.*)\) by (\S+) %)(?:, and the core by (.+) K (when the press opens|at the end of a run))?$/.exec(english);
  if (worth) return hardly(worth);
  const told = /^To tell (.+?): (.+)$/.exec(english);
  if (told) return `Um ${told[1].split(" from ").map((n) => `„${effectName(n)}“`).join(" von ")} zu unterscheiden: ${sentence(told[2])}`;
  const parts = english.split(/\.\s+|\.$|; (?=two or three sacrificial)/).filter(Boolean);
  const known = parts.map((part) => measurement(part));
  return known.every(Boolean) ? `${known.join(". ")}.` : english;
}
