// What the server says in English, in German: patterns for the sentences a person at the press sees.
// What matches none stays English; the journal keeps the wording the log files have.
import { reason } from "./reasons.js";
import { language, text } from "./text.js";

const PATTERNS = [
  [/^(\w+): never seen; start kerntemp \w+$/, "$1: noch nie gesehen; starten Sie kerntemp $1"],
  [/^(\w+): silent for (\d+) s; start kerntemp \w+$/, "$1: seit $2 s stumm; starten Sie kerntemp $1"],
  [/^logger (.+) does not answer: (.+); recording goes on without it, trying again$/, "Messgerät $1 antwortet nicht: $2; die Aufzeichnung läuft ohne es weiter und versucht es wieder"],
  [/^logger (.+) answers again$/, "Messgerät $1 antwortet wieder"],
  [/^the clock of this machine was set by (.+) s; .*$/, "die Uhr dieses Rechners wurde um $1 s gestellt; Zeiten innerhalb einer Pressung sind nicht betroffen"],
  [/^(\w+) has changed by (.+) since run (.+) \(noticed at (.+)\): .*$/, "$1 hat sich seit Pressung $3 um $2 geändert (bemerkt bei $4): prüfen Sie, was davor an der Presse getan wurde"],
  [/^run (.+) was interrupted; its data are kept$/, "Pressung $1 wurde unterbrochen; ihre Daten sind erhalten"],
  [/^run (.+) could not be fitted: (.+)$/, "Pressung $1 konnte nicht angepasst werden: $2"],
  [/^run (.+): (.+) changed$/, "Pressung $1: $2 geändert"],
  [/^model (.+) promoted$/, "Modell $1 eingesetzt"],
  [/^the live sensor takes model (.+)$/, "der Live-Sensor nimmt Modell $1"],
  [/^token (.+) created, scope (\w+)$/, "Schlüssel $1 angelegt, Recht $2"],
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
  [/^core not observable: band wider than (.+) K to either side$/, "Kern nicht bestimmbar: Band breiter als $1 K zu jeder Seite"],
  [/^press state unknown$/, "Pressenzustand unbekannt"],
  [/^core will peak at (.+) °C, above the limit of (.+) °C$/, "der Kern erreicht noch $1 °C, über der Grenze von $2 °C"],
  [/^core will peak at (.+) °C even if opened now, above (.+) °C$/, "der Kern erreicht $1 °C, auch wenn jetzt geöffnet wird, über $2 °C"],
  [/^core may pass (.+) °C in (.+) s: open the press$/, "der Kern kann in $2 s $1 °C überschreiten: Presse öffnen"],
  [/^None needed; .*$/, "Keine nötig; ein Kernfühler in einer Opferplatte im Monat würde den Kern bestätigen."],
  [/^Press at least (\d+) more panels, .* below (\d+) runs .*$/, "Pressen Sie mindestens $1 weitere Platten, mit verschiedenen Presszeiten und möglichst Dicken: unter $2 Pressungen ist Zufall von einer Ursache nicht zu trennen."],
  [/^Press three sacrificial panels with a core thermocouple .*$/, "Pressen Sie drei Opferplatten mit Kernfühler und sehen Sie die aufgeführten Zeiten und Stellen an."],
];

// One entry for each effect's confirming measurement (softsensor/effects).
const MEASUREMENTS = {
  "Touch a platen and a panel thermocouple at once with a soldering iron and compare": "Berühren Sie einen Heizplatten- und einen Plattenfühler gleichzeitig mit einem Lötkolben und vergleichen Sie",
  "Measure k of this board, or press panels of different thickness": "Messen Sie die Wärmeleitfähigkeit dieser Platte, oder pressen Sie verschiedene Dicken",
  "Measure k at 25 and 100 °C (guarded hot plate), or press a panel with a core thermocouple": "Messen Sie die Wärmeleitfähigkeit bei 25 und 100 °C, oder pressen Sie eine Platte mit Kernfühler",
  "Turn the panel over, or exchange the press plates": "Drehen Sie die Platte um, oder tauschen Sie die Pressbleche",
  "Repeat with bare panels and with twice the closing speed; log pressure": "Wiederholen Sie mit unbeschichteten Platten und doppelter Schließgeschwindigkeit; zeichnen Sie den Druck auf",
  "Press the same kind of panel at three pressures": "Pressen Sie gleiche Platten mit drei Drücken",
  "Measure the density profile (X-ray), or press a panel with a core thermocouple": "Messen Sie das Dichteprofil (Röntgen), oder pressen Sie eine Platte mit Kernfühler",
  "Insulate the rim, or compare sensors at the rim with sensors in the middle": "Dämmen Sie den Rand, oder vergleichen Sie Fühler am Rand mit solchen in der Mitte",
  "Weigh and measure the panel; measure its heat capacity; press panels of different thickness": "Wiegen und vermessen Sie die Platte; messen Sie ihre Wärmekapazität; pressen Sie verschiedene Dicken",
  "Measure c at 20 to 100 °C (DSC), or press a panel with a core thermocouple": "Messen Sie die Wärmekapazität von 20 bis 100 °C (DSC), oder pressen Sie eine Platte mit Kernfühler",
  "Wait two minutes between pressings, or tape a thermocouple to a press plate": "Warten Sie zwei Minuten zwischen Pressungen, oder kleben Sie einen Fühler auf ein Pressblech",
  "Weigh the panel before and after pressing, or press one dried to zero moisture": "Wiegen Sie die Platte vor und nach dem Pressen, oder pressen Sie eine darrtrockene",
  "Hold a sheet of aluminium foil between panel and upper plate before closing": "Halten Sie vor dem Schließen Aluminiumfolie zwischen Platte und oberes Blech",
  "Press the same board bare": "Pressen Sie dieselbe Platte unbeschichtet",
  "Compare the platen thermocouples with a calibrated one at working temperature": "Vergleichen Sie die Heizplattenfühler bei Betriebstemperatur mit einem kalibrierten",
  "Press the same panel a second time: cured resin gives no more heat": "Pressen Sie dieselbe Platte ein zweites Mal: ausgehärtetes Harz gibt keine Wärme mehr ab",
  "Check the named thermocouples: fixing, polarity, plug position": "Prüfen Sie die genannten Fühler: Befestigung, Polung, Steckplatz",
  "Use thinner wire, or put one thermocouple under a sheet of foil": "Nehmen Sie dünneren Draht, oder legen Sie einen Fühler unter Folie",
  "Dip one thermocouple into hot water and log its step response": "Tauchen Sie einen Fühler in heißes Wasser und zeichnen Sie die Sprungantwort auf",
  "Press one sacrificial panel with a thermocouple in its middle": "Pressen Sie eine Opferplatte mit Fühler in der Mitte",
  "Two or three sacrificial panels with a core thermocouple would settle the core temperature": "Zwei oder drei Opferplatten mit Kernfühler würden die Kerntemperatur klären",
};
const LOWER = Object.fromEntries(Object.entries(MEASUREMENTS).map(([english, german]) => [english.toLowerCase(), german]));

export const effectName = (effect) => { const key = `effect_${effect.replaceAll(" ", "_")}`; return text(key) === key ? effect : text(key); };

export function sentence(english) {
  if (language() !== "de" || !english) return english ?? "";
  for (const [pattern, german] of PATTERNS) if (pattern.test(english)) return english.replace(pattern, german);
  const why = reason(english, effectName);
  if (why) return why;
  const told = /^To tell (.+?): (.+)$/.exec(english);
  if (told) return `Um ${told[1].split(" from ").map(effectName).join(" von ")} zu unterscheiden: ${sentence(told[2])}`;
  const parts = english.split(/\.\s+|\.$/).filter(Boolean);
  const known = parts.map((part) => LOWER[part.toLowerCase()]);
  return known.every(Boolean) ? `${known.join(". ")}.` : english;
}
