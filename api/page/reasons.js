// Why a coefficient is not told by a run, and what a fit left out, in German: clause by clause
// (softsensor/remedies.py, fit_result.py, residuals.py). A clause that is not known here leaves the whole in English.
import { endingInMeasurement } from "./measurements.js";

const CLAUSES = [
  [/^it couples (.+) and (.+) while closed \((.+) s here\)$/, "er koppelt $1 und $2 bei geschlossener Presse (hier $3 s)"],
  [/^it couples (.+) and (.+)$/, "er koppelt $1 und $2"],
  [/^it acts at the face of (.+) while open \((.+) s before closing and (.+) s after opening here\)$/, "er wirkt an der Seite zu $1 bei offener Presse (hier $2 s vor dem Schließen und $3 s nach dem Öffnen)"],
  [/^it acts at (.+) and (.+) while open \((.+) s before closing and (.+) s after opening here\)$/, "er wirkt zwischen $1 und $2 bei offener Presse (hier $3 s vor dem Schließen und $4 s nach dem Öffnen)"],
  [/^it acts at a boundary$/, "er wirkt an einem Rand"],
  [/^it is a parameter of an effect$/, "er gehört zu einem Effekt"],
  [/^no reading of this run moves by more than (.+) K when it grows by e$/, "keine Messung dieser Pressung ändert sich um mehr als $1 K, wenn er um den Faktor e wächst"],
  [/^anything above (.+) fits as well: its resistance, below (.+) m²K\/W, is too small to be seen$/, "alles über $1 passt ebenso: sein Widerstand, unter $2 m²K/W, ist zu klein, um gesehen zu werden"],
  [/^it is known to a factor of (.+) only$/, "er ist nur auf einen Faktor $1 bekannt"],
  [/^it moves together with (.+) \(correlation (.+)\)$/, "er ändert sich gemeinsam mit $1 (Korrelation $2)"],
  [/^its effect of (.+) K drowns in the slow noise of the faces \((.+) K\)$/, "seine Wirkung von $1 K geht im langsamen Rauschen der Seiten ($2 K) unter"],
  [/^Put a thermocouple on the face of (.+) towards (.+), or let all runs share (.+) \(--shared .+\)$/, "Setzen Sie einen Fühler auf die Seite von $1 zu $2, oder lassen Sie alle Pressungen $3 teilen (--shared $3)"],
  [/^Put a thermocouple on the face of (.+) towards (.+)$/, "Setzen Sie einen Fühler auf die Seite von $1 zu $2"],
  [/^Put a thermocouple next to that boundary, or go on until its temperature has changed more$/, "Setzen Sie einen Fühler an diesen Rand, oder messen Sie weiter, bis sich seine Temperatur stärker geändert hat"],
  [/^Put a thermocouple next to that boundary$/, "Setzen Sie einen Fühler an diesen Rand"],
  [/^Stay closed for longer than the (.+) s here$/, "Halten Sie länger geschlossen als hier $1 s"],
  [/^Log a pressing that closes$/, "Zeichnen Sie eine Pressung auf, die schließt"],
  [/^Change the temperatures faster, or further$/, "Ändern Sie die Temperaturen schneller oder weiter"],
  [/^Leave the panel in the open press for a minute before closing instead of (.+) s$/, "Lassen Sie die Platte vor dem Schließen eine Minute statt $1 s in der offenen Presse"],
  [/^Log on for a minute after opening instead of (.+) s$/, "Messen Sie nach dem Öffnen eine Minute weiter statt $1 s"],
  [/^See the measurement that confirms the effect$/, "Siehe die Messung, die den Effekt bestätigt"],
  [/^Check the channels at (.+) against a thermometer before the run \(kerntemp calibrate\)$/, "Prüfen Sie die Kanäle an $1 vor der Pressung gegen ein Thermometer (kerntemp calibrate)"],
  [/^Calibrate the channels at (.+) at two temperatures$/, "Kalibrieren Sie die Kanäle an $1 bei zwei Temperaturen"],
  [/^Log faster than the (.+) Hz here, and log a limit switch as the column closed$/, "Messen Sie schneller als hier mit $1 Hz, und zeichnen Sie einen Endschalter als Spalte closed auf"],
  [/^Log faster than the (.+) Hz here$/, "Messen Sie schneller als hier mit $1 Hz"],
  [/^Log a limit switch as the column closed$/, "Zeichnen Sie einen Endschalter als Spalte closed auf"],
  [/^Log the channels at (.+) too, which this run lacks$/, "Zeichnen Sie auch die Kanäle an $1 auf, die dieser Pressung fehlen"],
  [/^Thermocouples sit on both sides already: no reading depends on it any more$/, "Auf beiden Seiten sitzen schon Fühler: keine Messung hängt mehr von ihm ab"],
  [/^Go on until its temperature has changed more$/, "Messen Sie weiter, bis sich seine Temperatur stärker geändert hat"],
  [/^Repeat the run with a hotter press: the open state is long enough$/, "Wiederholen Sie die Pressung mit heißerer Presse: offen war sie lange genug"],
  [/^the model does not describe this run: (.+) K left of readings that span (.+) K$/, "das Modell beschreibt diese Pressung nicht: $1 K bleiben bei Messungen, die $2 K überstreichen"],
  [/^the model does not describe this run: (.+) K left, and (.+) K at the values the search began with$/, "das Modell beschreibt diese Pressung nicht: $1 K bleiben, und $2 K waren es mit den Anfangswerten"],
  [/^Check its header, the press file, and that its rows show insertion and closing$/, "Prüfen Sie ihren Kopf, die Pressendatei, und ob ihre Zeilen Einlegen und Schließen zeigen"],
  [/^Start the record some seconds before the panel is laid in$/, "Beginnen Sie die Aufzeichnung einige Sekunden vor dem Einlegen"],
  [/^Measure the panel's start temperature, and write it into the header$/, "Messen Sie die Anfangstemperatur der Platte und tragen Sie sie in den Kopf ein"],
  [/^Calibrate the platen channel against the panel channels at one temperature \(kerntemp calibrate\)$/, "Kalibrieren Sie den Heizplattenkanal gegen die Plattenkanäle bei einer Temperatur (kerntemp calibrate)"],
  [/^(\d+) single cells departed from their face and were left out$/, "$1 einzelne Werte wichen von ihrer Seite ab und blieben weg"],
  [/^the search did not converge$/, "die Suche konvergierte nicht"],
  [/^coefficients are where it stopped$/, "die Koeffizienten stehen, wo sie endete"],
  [/^channel (.+) holds no usable value and is left out$/, "Kanal $1 hat keinen brauchbaren Wert und bleibt weg"],
  [/^channel (.+) follows (.+): swapped\? It is left out$/, "Kanal $1 folgt $2: vertauscht? Er bleibt weg"],
  [/^channel (.+) departs from its face by (.+) rms: loose or drifting$/, "Kanal $1 weicht um $2 (quadratisches Mittel) von seiner Seite ab: lose oder driftend"],
  [/^it is left out$/, "er bleibt weg"],
  [/^(\S+) = (.+) lies outside what the run allows, (.+) to (.+)$/, "$1 = $2 liegt außerhalb dessen, was die Pressung zulässt, $3 bis $4"],
  [/^stuck: it ends (.+) K rms from the readings, at the guesses it was (.+) K, and the default method reaches (.+) K$/, "steckengeblieben: $1 K von den Messungen, mit den Schätzwerten waren es $2 K, und das übliche Verfahren erreicht $3 K"],
  [/^fixed by the press file$/, "in der Pressendatei festgelegt"],
  [/^first model, coefficients of (\d+) runs$/, "erstes Modell, Koeffizienten aus $1 Pressungen"],
  [/^the diagnosis confirms it$/, "die Diagnose bestätigt es"],
  [/^nothing changed$/, "nichts geändert"],
  [/^(\d+) runs fitted, (\d+) are needed$/, "$1 Pressungen angepasst, $2 sind nötig"],
  [/^too few runs to judge by$/, "zu wenige Pressungen für ein Urteil"],
  [/^worse on held-out runs$/, "schlechter auf ungesehenen Pressungen"],
  [/^the gain is not significant$/, "der Gewinn ist nicht bedeutsam"],
  [/^the core gets worse$/, "der Kern wird schlechter"],
  [/^through the API$/, "über die API"],
  [/^rolled back$/, "zurückgesetzt"],
  [/^like (.+), which was rolled back$/, "wie $1, von dem zurückgegangen wurde"],
];
const ENDINGS = [
  [/^(.+), or fit it from about (\d+) such runs together$/, (m) => `, oder bestimmen Sie ihn aus etwa ${m[2]} solchen Pressungen gemeinsam`],
  [/^(.+), or take the joint estimate of these (\d+) runs$/, (m) => `, oder nehmen Sie die gemeinsame Schätzung dieser ${m[2]} Pressungen`],
  [/^(.+), or let all runs share (\S+) \(--shared \S+\)$/, (m) => `, oder lassen Sie alle Pressungen ${m[2]} teilen (--shared ${m[2]})`],
  [/^(.+), or go on until its temperature has changed more$/, () => ", oder messen Sie weiter, bis sich seine Temperatur stärker geändert hat"],
];
const VERDICT = { "one-sided": "nur einseitig bestimmt", "not identifiable": "nicht bestimmbar" };

const comma = (german) => german.replace(/(\d)\.(\d)/g, "$1,$2");

function clause(english) {
  const known = CLAUSES.find(([pattern]) => pattern.test(english));
  if (known) return english.replace(known[0], known[1]);
  for (const [pattern, german] of ENDINGS) {
    const found = pattern.exec(english);
    const first = found && clause(found[1]);
    if (first) return first + german(found);
  }
  return null;
}

// The German of a fit's warning or of a model version's reason; null where a part of it is not known.
export function reason(english, effectName) {
  const gain = /^([\w+ ]+): residual (\S+) -> (\S+) K on (\d+) runs(?:, core (\S+) -> (\S+) K live)?(?:; (.+))?$/.exec(english);
  if (gain) {
    const [, names, before, after, runs, coreBefore, coreAfter, but] = gain;
    const end = but ? clause(but) : "";
    if (end === null) return null;
    return comma(`${names.split(" + ").map(effectName).join(" + ")}: Residuum ${before} → ${after} K auf ${runs} Pressungen${coreBefore ? `, Kern ${coreBefore} → ${coreAfter} K live` : ""}${end && `; ${end}`}`);
  }
  const told = /^(\S+) is (one-sided|not identifiable): (.+)$/.exec(english);
  const [head, measured] = endingInMeasurement((told ? told[3] : english).replace(/\.$/, ""));
  const parts = head.split(/(; |\. )/).map((part, i) => (i % 2 ? part : clause(part)));
  if (parts.some((part) => part === null)) return null;
  return comma(`${told ? `${told[1]} ist ${VERDICT[told[2]]}: ` : ""}${parts.join("")}${measured && `. ${measured}`}`);
}
