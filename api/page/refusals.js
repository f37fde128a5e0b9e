// Why something did not work, in German: loggers, store, refused requests (daq/drivers, daq/store, api). Patterns as
// in sentences.js; a part in brackets that is a sentence of its own is put through `again`.
const LINK = {
  "connection refused": "Verbindung abgelehnt", unreachable: "nicht erreichbar", "no port": "kein solcher Anschluss", "no permission": "keine Berechtigung", "port in use": "Anschluss belegt",
  "the device is on but nothing listens there; check port": "das Gerät ist an, aber dort antwortet nichts; prüfen Sie den Port",
  "nobody answers at this address; check power, cable and host": "unter dieser Adresse antwortet niemand; prüfen Sie Strom, Kabel und Adresse",
  "no such port; check adapter and name": "diesen Anschluss gibt es nicht; prüfen Sie Adapter und Namen",
  "the user may not open it; add it to the port's group": "der Benutzer darf ihn nicht öffnen; nehmen Sie ihn in die Gruppe des Anschlusses auf",
  "another program has it open; close that": "ein anderes Programm hat ihn offen; beenden Sie dieses",
};
const STORE = {
  "another session holds a table; end it": "eine andere Sitzung hält eine Tabelle; beenden Sie sie",
  "another process holds it; close other programs that have the file open": "ein anderer Prozess hält ihn; schließen Sie Programme, die die Datei offen haben",
  "free space on the disk; recording goes on by itself": "schaffen Sie Platz auf der Platte; die Aufzeichnung läuft von selbst weiter",
  "no permission to write; check owner and mount of the file and its folder": "kein Schreibrecht; prüfen Sie Besitzer und Einhängung von Datei und Ordner",
  "check that the folder exists, may be written, and its disk is not mounted read-only": "prüfen Sie, ob der Ordner existiert und beschreibbar ist",
  "the disk failed; check it and its space, restore the newest backup if the file is hurt": "die Platte versagt; prüfen Sie sie und ihren Platz, und spielen Sie notfalls die neueste Sicherung ein",
  "the file is damaged; restore the newest backup with kerntemp backup --restore": "die Datei ist beschädigt; spielen Sie die neueste Sicherung ein: kerntemp backup --restore",
  "check that the database server runs and is reachable": "prüfen Sie, ob der Datenbankserver läuft und erreichbar ist",
  "check user and password in the URL": "prüfen Sie Benutzer und Passwort in der URL",
  "create the database, or correct the URL": "legen Sie die Datenbank an, oder berichtigen Sie die URL",
};
const REQUESTS = [
  [/^a change needs a token with scope write; kerntemp token create makes one$/, "eine Änderung braucht einen Schlüssel mit Schreibrecht; kerntemp token create legt einen an"],
  [/^token (.+) may read only; a change needs scope write$/, "Schlüssel $1 darf nur lesen; eine Änderung braucht das Schreibrecht"],
  [/^reading from elsewhere needs a token: .*$/, "von anderswo zu lesen braucht einen Schlüssel"],
  [/^this token is not valid; kerntemp token create makes one$/, "dieser Schlüssel gilt nicht; kerntemp token create legt einen an"],
  [/^too many wrong tokens from this address; wait a minute$/, "zu viele falsche Schlüssel von dieser Adresse; warten Sie eine Minute"],
  [/^without a token only a loopback host name is answered here$/, "ohne Schlüssel wird hier nur unter einem Namen dieses Rechners geantwortet"],
  [/^run (.+) does not exist; .*$/, "Pressung $1 gibt es nicht"],
  [/^model (.+) does not exist; .*$/, "Modell $1 gibt es nicht"],
  [/^run (.+) has not been fitted; kerntemp refit fits it$/, "Pressung $1 ist nicht angepasst; kerntemp refit holt es nach"],
  [/^run (.+): its press was stored without a press file$/, "Pressung $1: ihre Presse wurde ohne Pressendatei gespeichert"],
  [/^(?:run )?(\S+): header key (.+) = (.+): must be a number from (.+) to (.+)$/, "Pressung $1: $2 = $3: muss eine Zahl von $4 bis $5 sein"],
  [/^(?:run )?(\S+): header key (\S+) is missing and material (.+) is not in the table \((.+)\).*$/, "Pressung $1: $2 fehlt, und Material $3 steht nicht in der Tabelle ($4)"],
  [/^body\.header\.(.+)\.\[key\]: String should match pattern .*$/, "$1: ein Name hat nur Buchstaben, Ziffern, _ und -, mit Punkten dazwischen"],
  [/^(?:run )?(\S+): header key (\S+): the press file has no such place$/, "Pressung $1: $2 gibt es in der Pressendatei nicht"],
  [/^header\.(\S+) = (.+): must be a number$/, "$1 = $2: muss eine Zahl sein"],
  [/^store: header key (\S+) is missing.*$/, "$1 fehlt im Kopf"],
  [/^(?:run )?(\S+): header key (\S+) is missing.*$/, "Pressung $1: $2 fehlt"],
  [/^(?:store: )?column '(.+)' is empty for (.+) s around time_s = (.+); at most (.+) s of (.+) are bridged: cut the run there$/, "Spalte $1 ist um $3 s herum $2 s lang leer; höchstens $4 s von $5 werden überbrückt: kürzen Sie die Pressung dort"],
  [/^header\.(.+): not a header key that can change; see remark$/, "$1 lässt sich so nicht ändern; siehe Bemerkung"],
  [/^header\.(.+): cannot be a value and hold keys at once$/, "$1 kann nicht zugleich ein Wert sein und Schlüssel enthalten"],
  [/^too many live listeners; try again later$/, "zu viele Zuhörer; versuchen Sie es später wieder"],
  [/^the body may have (\d+) bytes at most$/, "die Anfrage darf höchstens $1 Bytes haben"],
  [/^the body did not arrive within (.+) s$/, "die Anfrage kam nicht innerhalb von $1 s an"],
  [/^the server failed at this; its log says where$/, "der Server ist daran gescheitert; sein Protokoll sagt, wo"],
];
const PLANT = [
  [/^scans begin$/, "Messzeilen beginnen"],
  [/^(\d+) scans left out, this machine was too busy$/, "$1 Messzeilen ausgelassen, dieser Rechner war überlastet"],
  [/^(\d+) scans left out in the last minute, this machine is too busy$/, "$1 Messzeilen in der letzten Minute ausgelassen, dieser Rechner ist überlastet"],
  [/^(\d+) scans wait to be written, this machine is too busy$/, "$1 Messzeilen warten auf das Speichern, dieser Rechner ist überlastet"],
  [/^(\d+) scans behind, this machine is too busy$/, "$1 Messzeilen im Rückstand, dieser Rechner ist überlastet"],
  [/^less than 2 GB left on the store's disk$/, "weniger als 2 GB frei auf der Platte des Speichers"],
  [/^the nightly job has not come to its end for (\d+) h; see its log$/, "der nächtliche Lauf ist seit $1 h nicht zu Ende gekommen; siehe sein Protokoll"],
  [/^(\d+) scans lost: the store was away for longer than there was room$/, "$1 Messzeilen verloren: der Speicher war länger weg, als Platz war"],
  [/^the changed configuration is in force$/, "die geänderte Konfiguration gilt"],
  [/^configuration changed; it takes effect between runs$/, "Konfiguration geändert; sie gilt zwischen zwei Pressungen"],
  [/^no reply in (.+) s; check power, cable and address$/, "keine Antwort in $1 s; prüfen Sie Strom, Kabel und Adresse"],
  [/^no answer yet$/, "noch keine Antwort"],
  [/^the line never falls silent$/, "die Leitung wird nie still"],
  [/^only replies to others came$/, "es kamen nur Antworten an andere"],
  [/^reply breaks off after (\d+) bytes$/, "die Antwort bricht nach $1 Bytes ab"],
  [/^checksum is wrong$/, "die Prüfsumme ist falsch"],
  [/^the device closed the connection$/, "das Gerät hat die Verbindung geschlossen"],
  [/^the limit switch says closed, but the upper face is cold; check switch and panel$/, "der Endschalter sagt zu, aber die Oberseite ist kalt; prüfen Sie Schalter und Platte"],
  [/^the limit switch says open, but the upper face is hot; check it$/, "der Endschalter sagt offen, aber die Oberseite ist heiß; prüfen Sie ihn"],
  [/^the pressure channel says closed, but the upper face is cold; check (?:pressure )?channel and panel$/, "der Druckkanal sagt zu, aber die Oberseite ist kalt; prüfen Sie Druckkanal und Platte"],
  [/^values are not corrected, (.+) is not there yet; kerntemp calibrate --write makes it$/, "die Werte sind nicht berichtigt, $1 gibt es noch nicht; kerntemp calibrate --write legt die Datei an"],
  [/^the pressure channel says open, but the upper face is hot; check it$/, "der Druckkanal sagt offen, aber die Oberseite ist heiß; prüfen Sie ihn"],
  [/^scan (\d+) is there already with other values; another recorder writes to this press: stop one of them$/, "Messzeile $1 ist mit anderen Werten schon da; ein zweiter Rekorder schreibt für diese Presse: beenden Sie einen"],
];

// Patterns with sentences in them, each with what makes German of its parts.
const WITHIN = [
  [/^run (\S+) has no panel sensors: nothing to fit$/, "Pressung $1 hat keine Fühler in der Platte: nichts anzupassen"],
  [/^run (\S+) could not be fitted: (.+)$/, (m, again) => `Pressung ${m[1]} konnte nicht angepasst werden: ${again(m[2])}`],
  [/^cannot open (\S+): ([^;]+); (.+)$/, (m) => LINK[m[3]] && `${m[1]} lässt sich nicht öffnen: ${LINK[m[2]]}; ${LINK[m[3]]}`],
  [/^cannot connect to (\S+): ([^;]+); (.+)$/, (m) => LINK[m[3]] && `keine Verbindung zu ${m[1]}: ${LINK[m[2]]}; ${LINK[m[3]]}`],
  [/^store (.+) takes data again; everything kept is written$/, (m) => `Speicher ${m[1]} nimmt wieder Daten an; alles Aufgehobene ist geschrieben`],
  [/^(.+); scans wait in memory, enough for (.+) h$/, (m, again) => `${again(m[1])}; Messzeilen warten im Arbeitsspeicher, genug für ${m[2]} h`],
  [/^(.+); scans wait in (.+), enough for (.+) h$/, (m, again) => `${again(m[1])}; Messzeilen warten in ${m[2]}, genug für ${m[3]} h`],
  [/^(.+) \((\d+) waiting\)$/, (m, again) => `${again(m[1])} (${m[2]} warten)`],
  [/^(.+); recording goes on with the configuration before$/, (m, again) => `${again(m[1])}; es wird mit der bisherigen Konfiguration weiter aufgezeichnet`],
  [/^store (\S+): (?:.*?; )?([^:]+)$/, (m) => Object.entries(STORE).filter(([end]) => m[2].endsWith(end)).map(([, german]) => `Speicher ${m[1]}: ${german}`)[0]],
  [/^(\d+) of (\d+) runs fitted, (\d+) could not be; diagnosis: (\w+); model (.+) promoted: (.+)$/, (m, again, word) => `${m[1]} von ${m[2]} Pressungen angepasst, ${m[3]} nicht möglich; Diagnose: ${word(`verdict_${m[4]}`)}; Modell ${m[5]} eingesetzt: ${again(m[6])}`],
  [/^(\d+) of (\d+) runs fitted, (\d+) could not be; diagnosis: (\w+); model (.+) stays: (.+)$/, (m, again, word) => `${m[1]} von ${m[2]} Pressungen angepasst, ${m[3]} nicht möglich; Diagnose: ${word(`verdict_${m[4]}`)}; Modell ${m[5]} bleibt: ${again(m[6])}`],
  [/^(\S+) rejected, (.+)$/, (m, again) => `${m[1]} abgelehnt, ${again(m[2])}`],
  [/^press ([^:]+): (.+)$/, (m, again) => `Presse ${m[1]}: ${again(m[2])}`],
  [/^logger ([^:]+): (.+)$/, (m, again) => `Messgerät ${m[1]}: ${again(m[2])}`],
  [/^(\S+(?: station \d+)?): (.+)$/, (m, again) => (again(m[2]) === m[2] ? undefined : `${m[1]}: ${again(m[2])}`)],
];

// The German of a refusal or a fault; undefined where it is not known.
export function refusal(english, again, word) {
  for (const [pattern, german] of [...REQUESTS, ...PLANT]) if (pattern.test(english)) return english.replace(pattern, german);
  for (const [pattern, german] of WITHIN) {
    const found = pattern.exec(english);
    const told = found && german(found, again, word);
    if (told) return told;
  }
  return undefined;
}
