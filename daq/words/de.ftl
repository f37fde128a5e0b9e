### Die Worte von Kerntemp auf Deutsch.
### Grammar: projectfluent.org. A message's name says where it belongs and what it means; its variables are the
### arguments of `say` in the code. Numbers: NUMBER($x, maximumFractionDigits: 1) rounds.
### Sections follow the rooms, those of the page its views; keep each in alphabetical order.

## general

at-column = Spalte { $column }: { $what }
at-key = { $key }: { $what }
at-key-value = { $key } = { $value }: { $what }
at-line = Zeile { NUMBER($line) }: { $what }
at-place = { $place }: { $what }
csv-cell-too-long = Eine Zelle hat mehr als 131.072 Zeichen
csv-line-end = Eine Zeile endet mit einem einzelnen Wagenrücklauf
csv-quotation-followed = Nach einem schließenden Anführungszeichen folgt Text
csv-quotation-open = Ein Anführungszeichen ist nicht geschlossen
database-busy = Die Datei ist durch ein anderes Programm gesperrt
database-damaged = Die Datei ist beschädigt
database-disk-failed = Fehler beim Lesen oder Schreiben auf dem Datenträger
database-full = Auf dem Datenträger ist kein Platz mehr
database-none = Die Datei ist keine Datenbank
database-not-opened = Die Datei lässt sich nicht öffnen
database-read-only = Die Datei ist schreibgeschützt
fault-and-more = { $first }; { $rest }
file-cannot-read = { $what } ist nicht lesbar: { $reason }
file-cannot-write = lässt sich nicht schreiben: { $reason }
file-changed = seit dem Schreiben verändert oder beschädigt; neu schreiben oder, um sie so zu verwenden, aus { $manifest } streichen
file-of-calibrations = die Kalibrierdatei
file-of-configuration = die Konfiguration
file-of-mapping = die Zuordnung
file-of-press = die Pressendatei
file-of-profile = das Profil
file-of-resin = die Harzdatei
file-of-run = die Laufdatei
json-invalid = unverständlich ab Zeile { NUMBER($line) }, Spalte { NUMBER($column) }
key-empty = ist leer; mindestens einen Eintrag angeben
key-missing = fehlt; bitte ergänzen
key-no-bool = muss true oder false sein
key-no-day = muss ein Tag sein, Jahr-Monat-Tag, etwa 2026-03-04
key-no-instant = muss ein Zeitpunkt sein, etwa 2026-03-04T07:00:00Z
key-no-list = muss eine Liste in Klammern sein
key-no-number = muss eine gültige Zahl sein
key-no-table = muss eine Tabelle sein
key-no-text = muss ein Text in Anführungszeichen sein
key-no-whole-number = muss eine gültige ganze Zahl sein
key-not-finite = muss eine endliche Zahl sein
key-one-of = muss { $known } sein
key-unknown = unbekannter Schlüssel; entfernen oder Schreibweise prüfen
key-unknown-meant = unbekannter Schlüssel; gemeint ist wohl { $meant }
limit-greater-than = muss größer als { NUMBER($limit, maximumFractionDigits: 6) } sein
limit-greater-than-equal = muss mindestens { NUMBER($limit, maximumFractionDigits: 6) } sein
limit-less-than = muss kleiner als { NUMBER($limit, maximumFractionDigits: 6) } sein
limit-less-than-equal = darf höchstens { NUMBER($limit, maximumFractionDigits: 6) } sein
list-of-names = { $names }
number-unknown = nicht bekannt
parquet-none = ihr Ende ist nicht das einer Parquet-Datei
parquet-page-damaged = die Prüfsumme einer Seite stimmt nicht
place-line = Zeile { NUMBER($line) }
place-model = Modell { $version }
place-press = Presse { $press }
place-row = Reihe { NUMBER($row) }
plain-text = { $text }
system-address-in-use = Die Adresse ist schon vergeben
system-address-not-here = Dieser Rechner hat die Adresse nicht
system-broken-pipe = Die Gegenseite nimmt nichts mehr an
system-busy = Das Gerät ist belegt
system-connection-refused = Verbindung abgelehnt
system-connection-reset = Die Gegenseite hat die Verbindung abgebrochen
system-disk-full = Auf dem Datenträger ist kein Platz mehr
system-exists-already = Es gibt die Datei schon
system-input-output = Fehler beim Lesen oder Schreiben
system-is-a-folder = Es ist ein Ordner
system-name-too-long = Der Dateiname ist zu lang
system-name-unknown = Der Name des Rechners ist unbekannt
system-no-network = Das Netz ist nicht erreichbar
system-no-route = Der Rechner ist nicht erreichbar
system-no-such-device = Das Gerät gibt es nicht
system-no-such-file = Datei oder Ordner nicht gefunden
system-not-a-folder = Es ist kein Ordner
system-not-allowed = Keine Berechtigung
system-read-only = Das Dateisystem ist schreibgeschützt
system-timed-out = Keine Antwort in der vorgesehenen Zeit
system-too-large = Die Datei ist zu groß
toml-integer-too-long = eine ganze Zahl mit mehr als { NUMBER($digits) } Ziffern; kürzen oder, wenn es ein Text ist, in Anführungszeichen setzen
toml-invalid = kein gültiges TOML: unverständlich ab Zeile { NUMBER($line) }, Spalte { NUMBER($column) }
toml-too-deep = Tabellen oder Listen mehr als { NUMBER($deepest) } Ebenen tief verschachtelt; flacher schreiben
toml-twice = kein gültiges TOML: ein Schlüssel oder eine Tabelle steht doppelt, bemerkt in Zeile { NUMBER($line) }; eines davon entfernen

## daq.drivers: loggers, wires, calibration

calibration-entry = Eintrag { NUMBER($number) }: { $what }
calibration-other-tables = nur Tabellen [[calibration]] sind bekannt, gefunden: { $found }
cause-babble = die Leitung schweigt nie
cause-busy = beschäftigt
cause-closed = geschlossen
cause-connection-refused = Verbindung abgelehnt
cause-crc = Prüfsumme falsch
cause-driver-fault = Fehler im Treiber
cause-echo = Echo falsch
cause-garbage = Datenmüll
cause-no-permission = keine Berechtigung
cause-no-port = kein Anschluss
cause-out-of-step = Antworten versetzt
cause-port-in-use = Anschluss belegt
cause-port-lost = Anschluss verloren
cause-refused = abgelehnt
cause-silent = stumm
cause-surplus = überzählige Bytes
cause-truncated = abgebrochen
cause-unreachable = nicht erreichbar
cause-wrong-id = falsche Station oder Nummer
cause-wrong-shape = falsche Form
connection-closed = das Gerät hat die Verbindung geschlossen
connection-lost = Verbindung verloren: { $reason }
line-babbles = { $place }: die Leitung schweigt nie
logger-channels-twice = channels nennt { $names } zweimal
logger-check-differs = { $place } Station { NUMBER($station) }: { $what } liefert { $found }, Profil { $profile } erwartet { $expected }
logger-closed = das Messgerät ist geschlossen
logger-needs-address = die Adresse dieses Geräts ist nicht gesichert bekannt; address angeben
logger-needs-baud = Messgerät { $logger }: die Baudrate dieses Geräts ist nicht gesichert bekannt; baud angeben
logger-needs-cold-junction = das Gerät liefert Spannungen; cold_junction_C angeben
logger-no-answer-yet = noch keine Antwort
logger-no-channels = channels nennt keine Spalte
logger-no-reply = { $place }: keine Antwort in { NUMBER($timeout_s) } s; Strom, Kabel und Adresse prüfen
logger-of-profile = Messgerät { $logger } ({ $profile })
logger-other-name = { $place }: das Gerät nennt sich { $found }, erwartet { $expected }
logger-port-or-host = entweder port (etwa "/dev/ttyUSB0") oder host (etwa "192.168.0.21") angeben
logger-refuses-set-up = { $place }: das Gerät lehnt die Einstellung ab: { $fault }
logger-rtu-on-host = transport = "rtu" braucht port; über ein Netz "rtu_over_tcp" verwenden
logger-scaling =
    { $given ->
        [yes] Skalierung '{ $scaling }' ist unbekannt; zur Wahl stehen: { $known }
       *[no] die Skalierung dieses Geräts ist nicht gesichert bekannt; zur Wahl stehen: { $known }
    }
logger-tcp-on-port = transport = "tcp" braucht host statt port
logger-tcp-port-alone = tcp_port braucht host
logger-too-many-channels = { NUMBER($channels) } Kanäle, das Gerät hat { NUMBER($inputs) } Eingänge
logger-uncorrected = Messgerät { $logger }: Werte sind nicht korrigiert, { $file } gibt es noch nicht; kerntemp calibrate --write legt sie an
modbus-busy =
    { $exception ->
        [4] das Gerät antwortet mit Ausnahme 4 (Gerätefehler)
        [5] das Gerät antwortet mit Ausnahme 5 (angenommen, noch in Arbeit)
        [6] das Gerät antwortet mit Ausnahme 6 (beschäftigt)
        [10] das Gateway antwortet mit Ausnahme 10 (kein Weg zum Gerät)
        [11] das Gateway antwortet mit Ausnahme 11 (das Gerät antwortet nicht)
       *[other] das Gerät antwortet mit Ausnahme { NUMBER($exception) }
    }
modbus-refused =
    { $exception ->
        [1] das Gerät lehnt die Anfrage ab: Ausnahme 1 (unzulässige Funktion); das Profil passt nicht
        [2] das Gerät lehnt die Anfrage ab: Ausnahme 2 (unzulässige Adresse); das Profil passt nicht
        [3] das Gerät lehnt die Anfrage ab: Ausnahme 3 (unzulässiger Wert); das Profil passt nicht
       *[other] das Gerät lehnt die Anfrage ab: Ausnahme { NUMBER($exception) }; das Profil passt nicht
    }
module-checksum =
    { $is_on ->
        [on] hat seine Prüfsumme eingeschaltet; checksum entsprechend setzen
       *[off] hat seine Prüfsumme ausgeschaltet; checksum entsprechend setzen
    }
module-format = schreibt keine technischen Einheiten; im Modul Datenformat 0 einstellen
module-name = nennt sich { $found }, das Profil erwartet { $expected }
module-refused = { $place } Modul { $address } { $why }
module-unknown-command = kennt { $command } nicht
port-cannot-connect = keine Verbindung zu { $place }
port-cannot-open = { $place } lässt sich nicht öffnen
port-lost = Anschluss verloren: { $reason }
port-no-socket = Anschluss { $port }: socket://host:port schreiben, etwa socket://192.168.0.50:4001
port-not-opened = { $what }: { $cause }; { $remedy }
port-remedy-connection-refused = das Gerät ist an, aber dort hört nichts; Port prüfen
port-remedy-no-permission = der Benutzer darf ihn nicht öffnen; in die Gruppe des Anschlusses aufnehmen
port-remedy-no-port = Adapter und Namen prüfen
port-remedy-port-in-use = ein anderes Programm hat ihn offen; dieses schließen
port-remedy-unreachable = unter dieser Adresse antwortet niemand; Strom, Kabel und host prüfen
port-two-settings = { $port }: zwei Messgeräte an einem Anschluss verlangen verschiedene Einstellungen: { $first }, { $second }
probe-fits = passt
probe-needs-place = probe: entweder --port oder --host angeben
probe-not-at-room-temperature = nicht auf Raumtemperatur
probe-reads-registers = lese Register von Station { NUMBER($station) }, Funktion { NUMBER($function) }
probe-tries-profile = versuche { $profile }
profile-bits-wide = values.format = '{ $format }': block.function 1 und 2 liefern Bits; 'u16' angeben
profile-block-short = block.count = { NUMBER($count) }, aber { NUMBER($inputs) } Werte enden bei { NUMBER($end) }
profile-check = Prüfung { $what }
profile-needs-tables = Protokoll { $protocol } braucht die Tabelle { $tables }
profile-not-established = { $key } ist für dieses Gerät nicht gesichert bekannt; als override.{ $key } angeben
profile-same-shape = { $what } hat die Form der Messwertabfrage; eine späte Antwort könnte für Messwerte gehalten werden: in Teilen lesen
profile-scale-or-code = entweder scale oder full_code und full_value angeben
profile-table-missing = Profil { $profile } hat keine Tabelle { $table }
profile-unknown = kein solches Profil; bekannt sind { $known }, oder den Pfad einer .toml angeben
profile-unknown-meant = kein solches Profil; gemeint ist wohl { $meant }, oder den Pfad einer .toml angeben
profile-with-scaling = { $profile } mit Skalierung { $scaling }
registers-float = Gleitkomma
registers-full-scale = { $full } = { NUMBER($celsius) } °C
registers-hundredths = Hundertstel
registers-low-word-first = { $meaning }, niederes Wort zuerst
registers-tenths = Zehntel
registers-whole-degrees = ganze Grad
reply-checksum = Prüfsumme falsch
reply-echo = das lokale Echo weicht vom Gesendeten ab
reply-endless = kein Zeilenende in { NUMBER($bytes) } Bytes
reply-field-count = { NUMBER($fields) } Felder für { NUMBER($channels) } Kanäle
reply-no-configuration = { $reply } ist keine Konfiguration
reply-no-modbus = der Datenstrom enthält kein Modbus-Telegramm
reply-no-open-mask = { $reply } ist keine Maske offener Eingänge
reply-no-status = { $reply } ist kein Status
reply-no-text = Antwort { $reply } enthält Bytes, die kein Text sind
reply-no-value = { $reply } ist kein Messwert
reply-other-channels = Kanäle { $found }, gefragt { $asked }
reply-other-head = Antwort beginnt mit { $found }, erwartet { $expected }
reply-other-lead = Antwort { $reply } auf { $command } beginnt nicht mit { $lead }
reply-other-station = Antwort von Station { NUMBER($found) }, gefragt { NUMBER($asked) }
reply-out-of-step = { $reply } an der Stelle des Gerätenamens: Antworten versetzt
reply-surplus =
    { $bytes ->
        [one] ein Byte nach dem Ende der Antwort
       *[other] { NUMBER($bytes) } Bytes nach dem Ende der Antwort
    }
reply-to-others = { $place }: es kamen nur Antworten an andere
reply-truncated =
    { $bytes ->
        [one] { $place }: Antwort bricht nach einem Byte ab
       *[other] { $place }: Antwort bricht nach { NUMBER($bytes) } Bytes ab
    }
reply-value-count = { $reply } sind nicht { NUMBER($values) } Messwerte
room-check-no-value = kein Wert
room-check-noisy = unruhig
room-check-off = daneben
room-check-ok = in Ordnung
room-check-too-few =
    { $readings ->
        [one] Prüfung bei Raumtemperatur: eine Messung; mindestens 2 aufnehmen
       *[other] Prüfung bei Raumtemperatur: { NUMBER($readings) } Messungen; mindestens 2 aufnehmen
    }
simulated-no-device = kein simuliertes Gerät '{ $profile }'; vorhanden: { $known }
simulated-no-effect = Effekt '{ $name }': unbekannt; bekannt sind { $known }
simulated-no-fault = Fehler '{ $name }': unbekannt; bekannt sind { $known }
simulated-no-input = --open { $given }: { $profile } hat die Eingänge 0 bis { NUMBER($last) }

## daq.press and daq.files: press file, run file, mapping, header

foreign-cell-count = { NUMBER($cells) } Zellen, aber Zeile { NUMBER($line) } nennt { NUMBER($columns) } Spalten
foreign-column-missing = Spalte '{ $column }' der Zuordnung steht nicht in der Datei; vorhanden: { $found }
foreign-column-twice = Spalte '{ $column }' der Zuordnung steht zweimal in der Datei; dort eine umbenennen
foreign-encoding-unknown = file.encoding = '{ $encoding }' ist unbekannt; utf-8 oder cp1252 versuchen
foreign-encoding-wrong = kein { $encoding }-Text bei Byte { NUMBER($byte) }; file.encoding setzen
foreign-header-empty = header_from.{ $key }: Spalte '{ $column }' enthält keinen Wert; den Schlüssel in [header] angeben
foreign-no-number = { $cell } ist keine Zahl mit Dezimalzeichen '{ $decimal }'; file.decimal setzen oder in file.missing aufnehmen
foreign-no-rows = auf Zeile { NUMBER($line) }, die die Spalten nennt, folgen keine Reihen
foreign-no-temperature = { $value } °C ist keine Temperatur; sie muss zwischen { NUMBER($coldest) } und { NUMBER($hottest) } °C liegen; die Einheit der Spalte angeben oder lower und upper setzen
foreign-time-falls = { $cell } steigt nicht; Reihen sortieren oder time.repeated = "first" setzen
foreign-time-format = { $cell } ist nicht '{ $format }'; time.format setzen
foreign-time-missing = { $cell } ist keine Zeit; jede Reihe braucht eine
foreign-too-short =
    { $lines ->
        [one] hat eine Zeile, aber file.header_line = { NUMBER($header_line) }
       *[other] hat { NUMBER($lines) } Zeilen, aber file.header_line = { NUMBER($header_line) }
    }
foreign-variant-twice = der Name dieser Datei passt zu zwei Varianten von '{ $of }', '{ $first }' und '{ $second }'; beide unterscheiden
foreign-variant-unknown = der Name dieser Datei passt zu keiner Variante von '{ $of }' in der Zuordnung ({ $known }); eine [[variant]] hinzufügen, die sagt, was für sie gilt, oder die Datei umbenennen
frame-column-complex = Spalte { $column } enthält komplexe Zahlen; den Realteil angeben oder je eine Spalte
frame-column-levels = die Namen der Spalten haben { NUMBER($levels) } Ebenen; zu einer verbinden, etwa mit '_'.join
frame-index-levels = { $run }: der Index hat { NUMBER($levels) } Ebenen ({ $names }); eine Pressung auf einmal angeben, etwa table.loc[name] oder table.groupby(level=0), oder Ebenen mit reset_index zu Spalten machen
frame-key-no-text = Schlüssel { $key } in attrs ist kein Text; die Schlüssel eines Kopfes sind Texte
frame-times-here = eine Spalte oder einen Index time_s in Sekunden geben oder einen Index aus Zeitpunkten (Texte werden es durch pandas.to_datetime)
frame-times-of-periods = ihr Index besteht aus Perioden, also table.to_timestamp() nehmen
frame-without-rows = { $run }: die Tabelle hat keine Zeilen; eine Pressung braucht mindestens eine Messzeile
frame-without-start = Im Kopf fehlt, wann die Pressung begann; { $key } als Zeitpunkt mit Zeitzone angeben oder time_s nehmen
frame-without-times = { $run }: die Tabelle hat keine Zeiten; { $remedy } (Spalten sind { $columns })
given-key-no-text = Schlüssel { $key } ist kein Text; Namen als Texte angeben
given-mapping-without-file = { $found }: eine Zuordnungsdatei erklärt die Datei eines fremden Loggers; gib den Pfad dieser Datei an, oder benenne die Spalten der Tabelle um und lass die Zuordnung weg
given-no-diagnosis = { $found }: eine Diagnose wird als das angegeben, was diagnose gab
given-no-effect = { $found }: ein Effekt wird als Effect angegeben
given-no-file = { $found }: eine Datei wird mit ihrem Pfad angegeben
given-no-header = { $found }: ein Kopf wird als Zuordnung von Schlüsseln mit Punkten angegeben, etwa {"{"}"panel.thickness_mm": 16.0{"}"}
given-no-language = Sprache { $language } ist nicht vorhanden; es gibt { $languages }
given-no-limits = { $found }: Grenzen werden als Zuordnung von Zahlen zu Namen angegeben, etwa {"{"}"core_least_C": 110.0{"}"}
given-no-mapping = { $found }: eine Zuordnungsdatei wird mit ihrem Pfad angegeben
given-no-measurement = { $found }: Messungen werden als Liste von Tupeln angegeben: ein Run, seine Moments und seine wahren Koeffizienten nach Namen
given-no-model = { $found }: ein Modell wird mit dem Pfad einer Modelldatei angegeben, als ModelFile oder als Ergebnis einer Anpassung oder Diagnose
given-no-names = { $found }: Namen werden als ein Text oder mehrere angegeben
given-no-press = { $found }: eine Presse wird mit dem Pfad einer Pressendatei angegeben oder als das, was read_press gab
given-no-press-name = { $found }: der Name einer Presse wird als Text angegeben
given-no-ranges = { $found }: Bereiche werden als Zuordnung von je zwei Zahlen zu Namen angegeben, etwa {"{"}"press_time_s": (60.0, 240.0){"}"}
given-no-resin = { $found }: ein Harz wird mit dem Pfad einer Harzdatei angegeben oder als Resin
given-no-run = { $found }: eine Pressung wird mit dem Pfad einer CSV- oder Parquet-Datei angegeben, als pandas-Tabelle oder als Run; die Tabelle einer anderen Bibliothek geht mit ihrem to_pandas()
given-no-scan = { $found }: eine Abtastung wird als Zuordnung von Zahlen zu Spalten angegeben oder als Zeile einer Tabelle
given-no-settings = { $found }: Einstellungen werden als Zuordnung von Zahlen zu Namen angegeben, etwa {"{"}"press_time_s": 90.0{"}"}
given-no-store = { $found }: eine Datenbank wird mit dem Pfad ihrer Datei angegeben oder mit ihrer Adresse postgresql://
given-no-table = { $found }: eine Tabelle wird als DataFrame von pandas angegeben; die einer anderen Bibliothek geht mit ihrem to_pandas()
given-no-thermal-model = { $found }: ein thermisches Modell wird als ThermalModel(press) angegeben
given-path-nul = { $path }: kein Dateiname enthält ein Nullzeichen; den Pfad berichtigen
header-far-from-table = Kopfschlüssel { $key } = { NUMBER($value) } { $unit } liegt weit von den { NUMBER($table) } { $unit } der Materialtabelle für { $material }; bitte prüfen
header-key-meant = Kopfschlüssel { $key } ist unbekannt; gemeint ist wohl { $meant }
header-key-twice = Kopfschlüssel { $key } ist zweimal angegeben; einen behalten
header-key-unknown = Kopfschlüssel { $key } ist unbekannt; er wird aufbewahrt, aber nicht verwendet
header-line-no-toml = '# { $text }' ist kein 'Schlüssel = Wert' in TOML ({ $reason }); Text in Anführungszeichen setzen, eine Bemerkung mit '##' beginnen
header-material-unknown = Material '{ $material }' steht nicht in der Tabelle ({ $known }), und { $missing } ist nirgends angegeben; das Material berichtigen oder Fehlendes angeben
header-missing = Kopfschlüssel { $key } fehlt; im Kopf ergänzen, in einer Datei als '# { $key } = ...'
header-missing-material = Kopfschlüssel { $key } fehlt und Material '{ $material }' steht nicht in der Tabelle ({ $known }); im Kopf ergänzen, in einer Datei als '# { $key } = ...'
header-no-number = Kopfschlüssel { $key } = { $value }: muss eine Zahl sein; den Kopf berichtigen
header-no-such-place = Kopfschlüssel { $key }: diese Stelle gibt es in der Pressendatei nicht
header-not-finite = Kopfschlüssel { $key } = { $value }: muss eine endliche Zahl sein; berichtigen oder, wo sie nicht bekannt ist, den Schlüssel entfernen
header-number-outside = Kopfschlüssel { $key } = { $value }: muss eine Zahl von { NUMBER($lower) } bis { NUMBER($upper) } { $unit } sein
header-override = Überschreibung im Kopf: { $what }
header-sd-not-positive = { $key } = { $value }: eine Standardabweichung muss eine positive Zahl sein
header-sd-too-wide = { $key } = { $value }: eine Standardabweichung ist höchstens { $most } { $unit }, die Breite dessen, was { $base } sein kann
header-section = '# { $text }': Abschnitte werden nicht gelesen; '# panel.key = value' schreiben
header-start-hot = { $key } = { NUMBER($value, maximumFractionDigits: 1) }: Hände und Raum erwärmen keine Platte über { NUMBER($limit, maximumFractionDigits: 0) } °C; die Starttemperatur prüfen
header-value-kind = Kopfwert { $value }: eine Laufdatei enthält Text, Zahlen, true/false, Zeiten und Listen
manifest-line = nicht 'SHA-256-Summe, zwei Leerzeichen, Datei'; die Zeile entfernen
mapping-header-source = header_from.{ $key }.column = '{ $column }': keine [[column]] führt dorthin
mapping-no-zone = muss eine Zeitzone wie Europe/Berlin sein
mapping-target-twice = column.to = '{ $column }' kommt zweimal vor; jede Spalte der Laufdatei hat eine Quelle
mapping-term-unknown = computed.to = '{ $to }': keine [[column]] führt zu seinem Glied '{ $column }'
mapping-variant-of-nothing = required_variants: keine [[variant]] hat of = '{ $of }'
play-pause = pause_s = { $value }: muss eine Zahl von Sekunden sein, mindestens 0
play-scans = scans = { $value }: muss eine ganze Zahl sein, mindestens 1
press-boundary-needs-coefficient = kind = "air" braucht coefficient, den Namen des Wärmeübergangskoeffizienten
press-boundary-needs-column = kind = "measured" braucht column, die Spalte der Laufdatei mit der Temperatur
press-boundary-no-flux-of-run = from_run gehört zu kind = "flux", nicht zu { $kind }: der Wärmestrom kommt damit aus dem Kopf der Laufdatei
press-coefficient-unused = { $name }: kein Kontakt und kein Rand verwendet ihn; verwendet werden { $used }
press-contact-cannot-part = von { $boundary } der Art '{ $kind }' kann sich keine Schicht trennen; einen Namen angeben
press-contact-no-neighbours = keine Nachbarn, von unten nach oben genannt; möglich sind { $possible }
press-contact-twice = zweimal angegeben
press-depth-outside = außerhalb der Schicht '{ $layer }', die { NUMBER($thickness_mm) } mm dick ist
press-guess-outside = guess = { NUMBER($guess) } liegt außerhalb von lower..upper = { NUMBER($lower) }..{ NUMBER($upper) }
press-initial-needs = kind = "uniform" braucht temperature_C, oder eine Schicht mit from_run, deren Anfang dann gilt
press-layer-needs = braucht { $keys } (oder from_run = true)
press-layer-outside = { $value } hat kein Stoff; muss eine Zahl von { NUMBER($lower, maximumFractionDigits: 6) } bis { NUMBER($upper, maximumFractionDigits: 6) } sein (Schicht '{ $layer }')
press-layer-surplus = from_run = true nimmt die Kennwerte aus der Pressung; { $keys } entfernen
press-layer-twice = Schichten brauchen verschiedene Namen; { $names } kommt zweimal vor
press-no-place = muss SCHICHT.bottom, SCHICHT.middle, SCHICHT.top oder {"{"} layer = SCHICHT, depth_mm = ... {"}"} sein
press-no-such-layer = diese Schicht gibt es nicht
press-open-above-closed = open_below = { NUMBER($open) } liegt über closed_above = { NUMBER($closed) }
press-prior-outside = außerhalb der Grenzen des Koeffizienten { NUMBER($lower) }..{ NUMBER($upper) }
press-prior-unknown = { $name }: diesen Koeffizienten gibt es nicht; verwendet werden { $used }
press-sd-of-nothing = { $key }.sd: daneben steht keine Zahl { $key }
press-table-not-rising = eine Tabelle braucht mindestens eine Zeile, mit steigenden Temperaturen
press-wire-as-temperature = würde als Temperatur gelesen, wegen '{ $pattern }'; den Kanal umbenennen
press-wire-twice = ist schon der Endschalter; eine andere Spalte nennen
printed-model = Modell { $version } der Presse { $press }
printed-more = ... und { $count } weitere
printed-nothing-missing = Wahrscheinlichkeit, dass dem Modell nichts fehlt: { NUMBER($percent, maximumFractionDigits: 0) } %, nach { $runs } { $runs ->
    [one] Pressung
   *[other] Pressungen
}
printed-panels = Platten: { $panels }
printed-press = Presse { $press }: { $chain }
printed-run = Pressung { $run }: { $scans } { $scans ->
    [one] Scan
   *[other] Scans
}, { $first } bis { $last } s
quality-form = { $text }: Spalte=Qualität schreiben, mit einem Leerzeichen zwischen zweien; eine Spalte mit anderen Worten umbenennen
quality-no-such-column = { $text } nennt Spalte { $column }, die es nicht gibt; den Namen berichtigen
quality-unknown = { $text }: { $quality } ist keine Qualität; es gibt { $known }
resin-limits-exclude = core_least_C = { $least } und core_most_C = { $most } schließen einander aus, die Presse öffnete nie; core_least_C kleiner als core_most_C wählen
resin-one-law = genau eine der Tabellen [order], [kamal] und [isoconversional] muss gegeben sein; die gemessene behalten
resin-one-rate = genau einer der Schlüssel rate_per_s (bei reference_temperature_C) und prefactor_per_s muss gegeben sein; den anderen weglassen
resin-rate-impossible = { $key }: mit der Aktivierungsenergie ist die Geschwindigkeit bei { NUMBER($at_C, maximumFractionDigits: 1) } °C 10^{ NUMBER($power, maximumFractionDigits: 1) } 1/s; sie muss zwischen 1e-12 und 1e6 1/s liegen. Prüfen, ob A in 1/s gegeben ist, Logarithmen natürliche sind und Energien in kJ/mol stehen
resin-sd-unused = { $key }.sd: nichts verwendet sie; den Schlüssel weglassen. Es zählen die sd von Geschwindigkeiten, Aktivierungsenergien und steam_most_kPa
resin-table-not-rising = braucht mindestens zwei Zeilen aus Umsatz, Aktivierungsenergie und ln(A f), der Umsatz steigend zwischen 0 und 1
run-archive-former = eine Messung, die eine frühe Version archiviert hat; sie ist nur über ihre Datenbank lesbar
run-archive-newer = von einer neueren Version von Kerntemp geschrieben; Kerntemp aktualisieren
run-cell-count =
    { $cells ->
        [one] 1 Zelle, aber die Kopfzeile hat { NUMBER($columns) } Spalten; einen fehlenden Wert als leere Zelle schreiben
       *[other] { NUMBER($cells) } Zellen, aber die Kopfzeile hat { NUMBER($columns) } Spalten; einen fehlenden Wert als leere Zelle schreiben
    }
run-closed-value = { NUMBER($value) } muss 0 (offen) oder 1 (geschlossen) sein
run-column-length = Spalte '{ $column }' ist nicht so lang wie time_s
run-column-twice = Spalte '{ $column }' kommt zweimal vor (Spalten { NUMBER($first) } und { NUMBER($second) }); eine umbenennen
run-column-type = Typ { $type } ist keine Zahl; als float64 speichern
run-column-unnamed = Spalte { NUMBER($number) } hat keinen brauchbaren Namen ({ $name }); jeder Spalte einen Namen geben
run-columns-unmatched = keine Spalte der Pressung „{ $run }“ passt zu { $pattern }; sie hat { $columns }
run-file-empty = die Datei ist leer; eine Laufdatei hat Zeilen '# Schlüssel = Wert', eine Kopfzeile und Reihen
run-header-row-numbers = die Kopfzeile fehlt: dort stehen Zahlen; sie beginnt mit time_s, ...
run-in-kelvin = Pressung { $run }: die Platte beginnt bei { NUMBER($start, maximumFractionDigits: 1) } °C, und ihr kältester Messwert ist { NUMBER($coldest, maximumFractionDigits: 1) }: sind die Messwerte in Kelvin? Eine Zuordnung mit unit = "K" rechnet sie um
run-no-commas = die Zellen sind nicht durch Kommas getrennt; Komma und Punkt verwenden oder mit einer Zuordnung einlesen
run-no-header-row = die Kopfzeile fehlt; sie beginnt mit time_s, ...
run-no-number = { $cell } ist keine Zahl; einen fehlenden Wert leer lassen
run-no-parquet = keine lesbare Parquet-Datei ({ $reason }); sie ist abgeschnitten oder beschädigt
run-no-rows = auf die Kopfzeile folgen keine Reihen; eine Pressung braucht mindestens eine Messzeile
run-no-temperature = { $value } ist keine Temperatur; sie muss zwischen { NUMBER($coldest) } und { NUMBER($hottest) } °C liegen; einen fehlenden Wert leer lassen
run-no-time = Spalte time_s fehlt; vorhanden: { $found }
run-not-utf8 = kein UTF-8-Text; die Datei als UTF-8 speichern
run-number-as-text = { $cell } ist eine als Text abgelegte Zahl; die Spalte in Gleitkommazahlen wandeln
run-parquet-rows = { $rows } Zeilen statt der angegebenen { $stated }
run-quotation = { $reason }; Anführungszeichen und Zeilenenden prüfen
run-table-empty = die Tabelle hat keine Reihen; eine Pressung braucht mindestens eine Messzeile
run-time-falls = time_s = { $time } steigt nicht ({ $place }: { $before }); Reihen sortieren, doppelte entfernen
run-time-missing = die Zeit fehlt; jede Reihe braucht eine
run-twice = die Pressung „{ $run }“ ist zweimal angegeben; jede zählt einmal
run-twice-by-readings = die Pressung „{ $run }“ enthält Ziffer für Ziffer die Messwerte der Pressung „{ $other }“; jede zählt einmal: eine davon weglassen
run-value-infinite = unendlich; muss eine Zahl sein
told-by-limit-switch = Endschalter
told-by-one-state = Presse mit einem Zustand
told-by-pressure-channel = Druckkanal
told-by-temperatures = Temperaturen
told-by-truth = virtuelle Presse
told-by-unknown = unbekannt
wire-closed-face-cold = { $wire } meldet geschlossen, aber die obere Seite ist kalt; { $wire } und Platte prüfen
wire-open-face-hot = { $wire } meldet offen, aber die obere Seite ist heiß; prüfen

## daq.process: configuration

config-closed-twice = Kanal '{ $channel }' wird aus { $wires } geschrieben; dem Kanal '{ $channel }' des Messgeräts einen anderen Namen geben
config-column-twice = zwei Messgeräte füllen Spalte '{ $column }'; jede Spalte kommt von einem Eingang
config-header = { $file }: Presse { $press }
config-logger-twice = zwei Messgeräte heißen '{ $logger }'; jedem einen eigenen Namen geben
config-no-archive = { $key } legt fest, wann Messzeilen archiviert werden, aber es gibt kein Archiv; einen Ordner als archive nennen oder den Schlüssel entfernen
config-no-boundary-channel = kein Messgerät hat den Kanal '{ $channel }', den boundary.{ $end } von { $file } braucht; bei den Kanälen eines Messgeräts ergänzen
config-no-such-press = Presse '{ $press }' steht nicht in der Konfiguration; vorhanden: { $known }
config-no-wire-channel = kein Messgerät hat den Kanal '{ $channel }', den { $key } nennt; bei den Kanälen eines Messgeräts ergänzen oder { $key } entfernen
config-press-twice = zwei Pressen heißen '{ $press }'; jeder einen eigenen Namen geben
config-pressings-only-too-early = pressings_only_after_days = { $days }: muss mehr sein als archive_after_days = { $archived }: Messzeilen werden archiviert, bevor sie gelöscht werden

## daq.recording: journal of the recorder

buffer-used-already = Puffer { $file }: ein anderer Rekorder benutzt ihn; diesen beenden oder jedem einen eigenen als store.buffer geben
clock-set = Die Uhr dieses Rechners wurde um { $sign }{ NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s verstellt; die Zeiten innerhalb einer Pressung bleiben richtig
configuration-changed = Konfiguration geändert; sie gilt ab der nächsten Pause zwischen zwei Pressungen
configuration-in-force = Die geänderte Konfiguration gilt jetzt
configuration-needs-start = { $file }: geändert: { $changed }; dafür kerntemp record neu starten
configuration-refused = { $why }; die Aufzeichnung läuft mit der bisherigen Konfiguration weiter
configuration-stalled = das Lesen von { $file }, oder einer Datei, die sie nennt, kommt nicht voran; den Datenträger prüfen; die Aufzeichnung läuft mit der bisherigen Konfiguration weiter
driver-stuck = { $press }: der Treiber des Messgeräts { $logger } ist aus einer Abfrage nicht zurückgekehrt
idle-not-thinned = Messwerte aus dem Leerlauf werden jetzt nicht ausgedünnt: { $why }
logger-back = Messgerät { $logger } antwortet wieder
logger-lost = Messgerät { $logger } antwortet nicht: { $why }; die Aufzeichnung läuft ohne es weiter, neue Versuche folgen
logger-problem = { $press }: Messgerät { $logger }: { $why }
needs-start-clock = [clock]
needs-start-presses = die Liste der Pressen
needs-start-store = [store]
of-press = Presse { $press }: { $what }
of-run = Pressung { $run }: { $what }
pages-stalled = die Prüfung von { $store } auf Schäden kommt nicht voran; den Datenträger prüfen
panel-next-damaged = Presse { $press }: die Angaben zu den nächsten Platten sind im Datenspeicher { $store } beschädigt und nicht lesbar; die Pressung beginnt ohne sie: neu angeben und die Kopfdaten der Pressung berichtigen
panel-not-pressed-before = { $key } = { NUMBER($header_mm, maximumFractionDigits: 1) }: keine frühere Pressung dieser Presse hatte eine solche Platte, die nächste hatte { NUMBER($nearest_mm, maximumFractionDigits: 1) } mm; das Band des Kerns umfasst beide; die Dicke prüfen
press-recorded-already = Presse { $press }: ein anderer Rekorder schreibt sie in { $store }; diesen zuerst beenden
press-stalled = { $press }: seit { SPAN($seconds) } keine neue Messzeile
problem-of-press = { $press }: { $what }
recording-begins = zeichnet { $presses } auf; solange der Datenspeicher nicht erreichbar ist, warten Messzeilen: { $where }
recording-ends = Aufzeichnung beendet
recording-now = zeichnet { $presses } auf
run-interrupted = Pressung { $run } wurde unterbrochen; ihre Daten sind erhalten
scans-begin = Presse { $press }: Messzeilen beginnen
scans-begin-late = Presse { $press }: die Aufzeichnung beginnt mit einer Platte, die schon heiß ist; wird sie gerade gepresst, wird der Rest dieser Pressung nicht als Pressung gespeichert: ihre Messzeilen bleiben wie die einer leeren Presse; ein Endschalter oder Druckkanal zeigt es
scans-behind-others = Presse { $press }: der andere Rekorder hat seit { SPAN($seconds) } nichts geschrieben; was hier wartete, wird nach dessen Messzeilen gespeichert
scans-left-out = Presse { $press }: { $count ->
        [one] eine Messzeile
       *[other] { $count } Messzeilen
    } ausgelassen, dieser Rechner war überlastet
scans-left-out-lately = { $press }: { $count ->
        [one] eine Messzeile
       *[other] { $count } Messzeilen
    } in der letzten Minute ausgelassen, dieser Rechner ist überlastet
scans-lost = { $count ->
        [one] eine Messzeile
       *[other] { $count } Messzeilen
    } verloren: der Datenspeicher war länger nicht erreichbar, als der Platz reichte
scans-not-written = { $count } Messzeilen sind noch nicht geschrieben, dieser Rechner ist überlastet
scans-recorded = { $count } Messzeilen aufgezeichnet
store-trouble = { $why } ({ $count } warten)

## daq.store: the store

archive-clock-ahead = { $press }: die Uhr geht { $days } Tage nach der Nacht davor; keine archivierten Messzeilen werden gelöscht, bis der nächtliche Lauf nach dieser Uhr einen Monat lang gelaufen ist; die Uhr prüfen und, wenn sie falsch geht, stellen
archive-file-damaged = Archivdatei { $file }: nicht mehr, was geschrieben wurde; sie aus einer Sicherung des Archivs zurückholen
archive-file-mended = die Archivdatei der Pressung { $run } ist wieder heil
archive-file-missing = Archivdatei { $file }: fehlt; sie aus einer Sicherung des Archivs zurückholen oder ihren Datenträger einhängen
archive-file-newer = Archivdatei { $file }: von einer neueren Version geschrieben; Kerntemp aktualisieren
archive-file-taken = Archivdatei { $file }: gibt es schon mit anderem Inhalt, vielleicht von einem anderen Datenspeicher; jedem einen eigenen Ordner als store.archive geben oder diese Datei wegräumen; nichts wurde gelöscht
archive-file-unreadable = Archivdatei { $file }: { $reason }; Datenträger und Leserechte prüfen
archive-folder-lacks = Archiv { $folder }: darin fehlt { $file }, archiviert in { $before }; den Datenträger einhängen, das Archiv dorthin kopieren oder store.archive berichtigen; nichts wurde geändert
archive-folder-refused = Archiv { $folder }: { $reason }; den Ordner anlegen und den Dienst hineinschreiben lassen oder store.archive berichtigen
archive-not-as-written = Archivdatei { $file }: das Zurückgelesene weicht vom Geschriebenen ab; den Datenträger prüfen; nichts wurde gelöscht
archive-not-written = Archivdatei { $file }: { $reason }; Datenträger und freien Platz prüfen; nichts wurde gelöscht
archive-run-changed = Pressung { $run }: ihre Messzeilen änderten sich beim Archivieren; nichts wurde gelöscht, die nächste Nacht versucht es wieder
archive-run-removed = Pressung { $run }: ihre Messzeilen wurden am { $date } gelöscht, wie store.pressings_only_after_days es vorgibt; ihre Kopfdaten und ihre Koeffizienten bleiben
backup-damaged = Sicherung { $file }: beschädigt: { $error }; eine andere Sicherung nehmen
backup-exists = Sicherung { $file }: gibt es schon; einen neuen Namen geben, Sicherungen werden nie überschrieben
backup-failed = Sicherung { $file }: { $error }; Datenträger und freien Platz prüfen
backup-missing = Sicherung { $file }: gibt es nicht
backup-newer = Sicherung { $file }: von einer neueren Version angelegt (Schema { $schema }, diese kennt { $known }); Kerntemp aktualisieren
backup-no-folder = Sicherung { $file }: den Ordner { $folder } gibt es nicht; ihn anlegen
backup-rows-missing = Sicherung { $file }: beschädigt: Zeilen verweisen auf Zeilen, die fehlen
backup-run-short = Sicherung { $file }: der Pressung { $run } fehlt die erste oder letzte Messzeile; eine andere Sicherung nehmen
backup-unsound = Sicherung { $file }: kein heiler Datenspeicher: { $error }; eine andere Sicherung nehmen
buffer-damaged = Puffer { $file } ist beschädigt ({ $error }): als { $aside } beiseitegelegt; { $kept ->
        [one] ein Eintrag war lesbar und bleibt
       *[other] { $kept } Einträge waren lesbar und bleiben
    }, { $lost } { $lost ->
        [one] ist
       *[other] sind
    } verloren; die Aufzeichnung läuft weiter
buffer-damaged-uncounted = Puffer { $file } ist beschädigt ({ $error }): als { $aside } beiseitegelegt; { $kept ->
        [one] ein Eintrag war lesbar und bleibt
       *[other] { $kept } Einträge waren lesbar und bleiben
    }; wie viele verloren sind, ist nicht bekannt, mindestens { $lost }; die Aufzeichnung läuft weiter
buffer-emptied = Puffer { $file }: jemand hat ihn gelöscht; { $count ->
        [one] ein Eintrag ist
       *[other] { $count } Einträge sind
    } verloren; die Aufzeichnung läuft weiter
buffer-gone = Puffer { $file } ist weg ({ $error }): neu angelegt; { $lost ->
        [one] ein Eintrag ist
       *[other] { $lost } Einträge sind
    } verloren; die Aufzeichnung läuft weiter
buffer-place-is-folder = store.buffer = { $file }: ist ein Ordner; eine Datei darin angeben
buffer-place-no-folder = store.buffer = { $file }: den Ordner { $folder } gibt es nicht; ihn anlegen oder eine andere Datei angeben
buffer-place-no-permission = keine Rechte zum Lesen und Schreiben
buffer-place-refused = store.buffer = { $file }: { $reason }; Besitzer und Einbindung des Ordners und den Platz auf dem Datenträger prüfen oder eine andere Datei angeben
buffer-refuses = Puffer { $file }: { $error }; auf seinem Datenträger Platz schaffen
buffer-rows-unreadable =
    { $count ->
        [one] Puffer { $file }: ein Eintrag ist nicht lesbar ({ $error }); er liegt nun in { $aside }
       *[other] Puffer { $file }: { $count } Einträge sind nicht lesbar (der erste: { $error }); sie liegen nun in { $aside }
    }
buffer-sum-wrong = Prüfsumme falsch
buffer-unusable = Puffer { $file }: { $error }; seinen Datenträger und Ordner prüfen oder eine andere Datei als buffer in [store] angeben; die Aufzeichnung läuft weiter, aber solange der Datenspeicher nicht erreichbar ist, warten Messzeilen im Arbeitsspeicher
event-twice = Presse { $press }: { $kind } ist zu einem anderen Zeitpunkt der Messzeile { $scan } schon aufgezeichnet; das zweite Ereignis wird nicht gespeichert
events-lost = Presse { $press }: { $count ->
        [one] ein Ereignis
       *[other] { $count } Ereignisse
    } verloren: der Datenspeicher war länger nicht erreichbar, als der Platz reichte
item-set-aside = Presse { $press }: der Datenspeicher nimmt { $what } nicht an: { $why }; beiseitegelegt in { $aside }, alles andere ist geschrieben
left-unwritten =
    { $count ->
        [one] ein Eintrag ist nicht geschrieben: Datenspeicher { $store } nimmt ihn nicht an; er geht verloren, wenn dieser Prozess endet
       *[other] { $count } Einträge sind nicht geschrieben: Datenspeicher { $store } nimmt sie nicht an; sie gehen verloren, wenn dieser Prozess endet
    }
line-set-aside = Der Datenspeicher nimmt eine Zeile des Journals nicht an; sie liegt in { $aside }
model-from-sisters = gelernt von { $count ->
    [one] einer Presse
   *[other] { $count } Pressen
} derselben Bauart: { $sisters }
model-promoted = Modell { $version } in Kraft gesetzt
model-rolled-back = zurückgenommen
model-through-api = über die API
model-version-missing = Modellversion '{ $version }' ist nicht im Datenspeicher
model-version-taken = Modellversion '{ $version }' ist schon im Datenspeicher; Versionen ändern sich nie
process-failed = { $process } wurde beendet: { $why }
recipe-damaged = Rezept { $recipe } ist im Datenspeicher { $store } beschädigt und nicht lesbar; seine Werte unter demselben Namen neu angeben
recipe-unknown = Rezept '{ $recipe }' gibt es nicht; es gibt: { $known }
restore-differs = Datenspeicher { $store }: enthält nach dem Einspielen { $found }, die Sicherung { $expected }
run-end-without-run = Pressung { $run } endet bei Messzeile { $scan }, aber der Datenspeicher hat keine solche Pressung; ihre Messzeilen sind erhalten
run-renamed = Pressung { $run } ist schon im Datenspeicher; diese Pressung wird als { $name } gespeichert
run-short = der Pressung { $run } fehlen die ersten oder letzten Messzeilen im Datenspeicher; sie gilt jetzt als unterbrochen und hat nur die übrigen; eine ältere Sicherung hat vielleicht alle
scans-given-up = Der Datenspeicher ist zu lange nicht erreichbar: die ältesten wartenden Messzeilen werden verworfen; Puffer: { $where }
scans-wait = { $why }; Messzeilen warten: { $where }
set-aside-begin = den Beginn der Pressung { $run } mit allen Kopfdaten
set-aside-scans = eine Messzeile mit ihren Ereignissen
sign-of-life-refused = { $why }; die Aufzeichnung geht weiter, aber ihr Lebenszeichen wird nicht gespeichert: Zustand und Seite nennen sie stumm
store-back = Datenspeicher { $store } nimmt wieder Daten an; alles Aufgehobene ist geschrieben
store-column-missing = Pressung '{ $run }' hat keine Spalte '{ $column }'; sie hat { $columns }
store-cursor = Cursor '{ $cursor }': gehört nicht zu dieser Liste; next_cursor der Seite davor nehmen
store-damaged = Datenspeicher { $store }: die Datei ist beschädigt: { $error }; das Lesbare sichern, dann die neueste heile Sicherung mit kerntemp backup --restore einspielen
store-file-gone = Datenspeicher { $store }: die Datei wurde gelöscht oder verschoben; ein laufendes kerntemp record legt sie wieder an, sonst die neueste Sicherung einspielen
store-foreign-view = Datenspeicher { $store }: die Sicht { $view } ist nicht von Kerntemp und hängt von einer ab, die diese Version ändert; sie löschen, neu starten und sie neu anlegen
store-gives-no-reason = ohne Angabe eines Grundes
store-header-damaged = ihre Kopfdaten sind im Datenspeicher { $store } beschädigt und nicht lesbar; die anderen Pressungen sind es; mit kerntemp backup --restore eine Sicherung daneben herstellen und die Pressung dort holen
store-header-wrong = { $file }: Kopfzeile { $key } = { $value }: muss { $wanted } sein; berichtigen oder weglassen
store-is-closed = Datenbank { $store }: ist geschlossen; mit daq.open_store wieder öffnen
store-is-folder = Datenspeicher { $store }: ist ein Ordner; den Pfad einer Datei darin angeben
store-missing = Datenspeicher { $store }: gibt es nicht; kerntemp record starten oder den richtigen Pfad angeben
store-newer = Datenspeicher { $store }: von einer neueren Version angelegt (Schema { $schema }, diese Version kennt { $known }); Kerntemp aktualisieren oder einen anderen Datenspeicher angeben
store-no-folder = Datenspeicher { $store }: den Ordner { $folder } gibt es nicht; ihn anlegen
store-not-empty = Datenspeicher { $store }: enthält schon Daten; nur an einem neuen Ort einspielen
store-not-sqlite = Datenspeicher { $store }: keine SQLite-Datei, oder ihre erste Seite ist zerstört; die neueste Sicherung mit kerntemp backup --restore einspielen oder einen anderen Pfad angeben
store-nul = Datenspeicher { $store }: ein Text enthält ein NUL-Zeichen, das der Server nicht aufnimmt; es entfernen
store-overwritten = Datenspeicher { $store }: an seinem Platz wurde eine ältere Kopie über ihn geschrieben; die Aufzeichnung läuft dort weiter, mit dem, was noch im Speicher war; was seit der Kopie sonst aufgezeichnet wurde, ist nicht mehr darin
store-press-gone = Datenspeicher { $store }: Presse { $press } gibt es in ihm nicht mehr, an seinem Platz liegt ein anderer oder älterer; die Aufzeichnung läuft dort weiter, was er vorher enthielt, steht nur in dem, was fortgelegt wurde, oder in einer Sicherung
store-refuses = Datenspeicher { $store }: { $reason }
store-refuses-remedy = Datenspeicher { $store }: { $reason }; { $remedy }
store-remedy-damaged = die Datei ist beschädigt; die neueste Sicherung mit kerntemp backup --restore einspielen
store-remedy-database = die Datenbank anlegen oder die URL berichtigen
store-remedy-disk-failed = der Datenträger hat versagt; ihn und seinen Platz prüfen, bei beschädigter Datei die neueste Sicherung einspielen
store-remedy-folder = prüfen, ob es den Ordner gibt, ob er beschreibbar ist und sein Datenträger nicht nur lesbar eingehängt ist
store-remedy-full = Platz auf dem Datenträger schaffen; die Aufzeichnung geht dann von selbst weiter
store-remedy-lock-timeout = eine andere Sitzung hält eine Tabelle fest; sie beenden
store-remedy-locked = ein anderer Prozess hält sie fest; andere Programme schließen, die die Datei offen haben
store-remedy-password = Benutzer und Passwort in der URL prüfen
store-remedy-read-only = keine Schreibrechte; Eigentümer und Einhängung der Datei und ihres Ordners prüfen
store-remedy-server = prüfen, ob der Datenbankserver läuft und erreichbar ist
store-remedy-server-damaged = die Daten des Servers sind beschädigt; ein Index entsteht durch REINDEX neu, sonst die neueste Sicherung mit kerntemp backup --restore einspielen
store-remedy-server-permission = der Benutzer darf dort nicht mehr schreiben; ihm die Rechte wieder geben
store-remedy-server-read-only = der Server nimmt keine Änderungen an, wie ein Ersatzserver; sie wieder zulassen oder die URL berichtigen
store-remedy-server-tables = eine Tabelle oder Spalte fehlt; das Einspielen zu Ende führen oder die neueste Sicherung mit kerntemp backup --restore einspielen
store-rescued = Datenspeicher { $store }: die Datei wurde gelöscht, verschoben oder ausgetauscht; alles ist an ihrem Platz neu geschrieben, die Aufzeichnung läuft dort weiter
store-rescued-beside = Datenspeicher { $store }: an seinen Platz wurde ein anderer gelegt; dieser liegt nun unter { $aside }, der aufgezeichnete ist neu geschrieben, die Aufzeichnung läuft dort weiter
store-rescued-cut = Datenspeicher { $store }: sein Protokoll (-wal) wurde geleert oder gekürzt; die Datei ist ohne es neu geschrieben, mit { $count ->
        [one] dem einen neuesten Eintrag
       *[other] den { $count } neuesten Einträgen
    } des Rekorders; was andere Prozesse in den letzten Sekunden gespeichert haben, kann verloren sein; die vorgefundene Datei liegt nun unter { $aside }
store-rescued-log = Datenspeicher { $store }: sein Protokoll (-wal, -shm) wurde gelöscht oder ausgetauscht; alles ist neu geschrieben, die Aufzeichnung läuft dort weiter; die Datei ohne ihre neuesten Einträge liegt nun unter { $aside }
store-run-missing = Pressung '{ $run }' ist nicht im Datenspeicher; kerntemp export listet die Pressungen, eine Datei braucht ihren Pfad
store-run-missing-here = Pressung '{ $run }' ist nicht im Datenspeicher { $store }; runs() listet die vorhandenen
store-run-name = { $file }: Kopfzeile run = { $name }: muss ein Name aus 1 bis 200 Bytes sein, ohne Schrägstriche, Zeilenumbrüche, unsichtbare Zeichen und Leerzeichen am Rand; nichts wurde importiert
store-run-renamed = Pressung '{ $run }': der Name einer Pressung lässt sich nicht ändern
store-run-taken = { $file }: Pressung '{ $run }' ist schon im Datenspeicher; nichts wurde importiert; die Kopfzeile run ändern
store-scan-damaged = Messzeile { NUMBER($scan, useGrouping: 0) } ist im Datenspeicher { $store } beschädigt und nicht lesbar; die anderen Pressungen sind es; mit kerntemp backup --restore eine Sicherung daneben herstellen und die Pressung dort holen
store-scan-taken = Presse { $press }: Messzeile { $scan } ist schon mit anderen Werten da; ein anderer Rekorder schreibt für diese Presse: einen der beiden beenden
store-scans-damaged = ihre Messzeilen sind im Datenspeicher { $store } beschädigt und nicht lesbar; mit kerntemp backup --restore eine Sicherung daneben herstellen und die Pressung dort holen
store-scans-missing = Messzeilen von ihr fehlen im Datenspeicher { $store }; mit kerntemp backup --restore eine Sicherung daneben herstellen und die Pressung dort holen
store-taken-over = Datenspeicher { $store }: von der Datei, in die aufgezeichnet wurde, ist nichts mehr da; die Aufzeichnung läuft in dem weiter, was jetzt an ihrem Platz liegt
store-trying-again = { $why }; neue Versuche folgen
store-url-at = Das Passwort in der URL des Datenspeichers enthält ein @: als %40 schreiben
store-url-mistyped = Die URL des Datenspeichers ist weder ein Dateipfad noch eine ganze URL (nicht gezeigt, sie kann ein Passwort enthalten); einen Dateipfad oder postgresql://benutzer:passwort@rechner/name angeben
store-url-no-file = Datenspeicher-URL '{ $url }': im Datenspeicher treffen sich Prozesse, er braucht einen Dateipfad
store-url-unsupported = Datenspeicher-URL '{ $url }': { $engine } wird nicht unterstützt; einen Dateipfad oder postgresql://... angeben
store-url-wrong = Datenspeicher-URL '{ $url }': keine URL; einen Dateipfad oder postgresql://benutzer@rechner/name angeben
store-went-back = Datenspeicher { $store }: er ist auf einem älteren Stand, etwa dem einer Sicherung oder eines Ersatzservers; die Messzeilen { NUMBER($first, useGrouping: 0) } bis { NUMBER($last, useGrouping: 0) } der Presse { $press } und was zu ihnen gehört waren geschrieben und fehlen jetzt; im ersetzten Stand nach ihnen suchen
store-without-tables = Datenspeicher { $store }: seine Tabellen fehlen oder sind nicht vollständig, wie während eine Sicherung eingespielt wird; das zu Ende führen oder kerntemp record neu starten, das dort einen leeren Datenspeicher anlegt
thread-failed = { $thread }: { $why }; wird neu gestartet
thread-stalled = { $thread }: seit { SPAN($seconds) } kein Fortschritt; den Dienst neu starten
unexpected-error = unerwarteter Fehler ({ $kind }: { $error }); bitte melden
waits-in-buffer = in { $file }, Platz für { NUMBER($hours, maximumFractionDigits: 0) } h
waits-in-memory = im Arbeitsspeicher, Platz für { NUMBER($hours, minimumFractionDigits: 1, maximumFractionDigits: 1) } h
wanted-one-of = eines von { $names }
wanted-seconds = eine Zahl in Sekunden
wanted-text = ein Text
wanted-time = eine Zeit mit Zeitzone zwischen den Jahren 1970 und 9999, wie 2026-03-04T07:00:00Z
writer-dead = Der Schreiber zum Datenspeicher läuft nicht
writer-stalled = Der Schreiber zum Datenspeicher steht seit { SPAN($seconds) }

## softsensor.effects: the catalogue of effects

body-air = Luft
body-panel = Platte
body-plate = Pressblech
body-plate-lower = unteres Pressblech
body-plate-upper = oberes Pressblech
body-platen = Heizplatte
body-platen-lower = untere Heizplatte
body-platen-upper = obere Heizplatte
coupling-always = { $one } – { $other }
coupling-and = { $first } und { $second }
coupling-closed = { $one } – { $other }, geschlossen
coupling-open = { $one } – { $other }, offen
coupling-surroundings-bottom = Unterseite – Umgebung
coupling-surroundings-top = Oberseite – Umgebung
effect-chance-impossible = Effekt { $name }: chance = { $value }: eine Wahrscheinlichkeit liegt zwischen 0 und 1
effect-clock_offset-called = Uhren, die voneinander abweichen
effect-clock_offset-confirmed-by = Einen Heizplatten- und einen Plattenfühler gleichzeitig mit einem Lötkolben berühren und vergleichen.
effect-clock_offset-core = Für sich keine, aber sie verfälscht die Kontaktkoeffizienten.
effect-clock_offset-meaning = Die Plattenkanäle tragen spätere (oder frühere) Zeiten als die Heizplattenkanäle und der Endschalter.
effect-clock_offset-symptom = Jeder Knick der Plattenmessung ist um dieselbe Zeit verspätet, beim Schließen wie beim Öffnen.
effect-conductivity_offset-called = andere Wärmeleitfähigkeit als angegeben
effect-conductivity_offset-confirmed-by = Die Wärmeleitfähigkeit dieser Platte messen oder verschiedene Dicken pressen.
effect-conductivity_offset-core = Der Kern ist heißer (Verhältnis über 1) oder kühler, etwa 1 K je 5 %.
effect-conductivity_offset-meaning = Die Wärmeleitfähigkeit der Platte weicht vom Wert in den Kopfdaten ab.
effect-conductivity_offset-symptom = Die Seiten entfernen sich in jedem Zustand mit der Wurzel der Zeit von der Simulation.
effect-conductivity_temperature-called = Wärmeleitfähigkeit, die von der Temperatur abhängt
effect-conductivity_temperature-confirmed-by = Die Wärmeleitfähigkeit bei 25 und 100 °C messen (Zweiplattengerät) oder eine Platte mit Kernfühler pressen.
effect-conductivity_temperature-core = Steigt die Wärmeleitfähigkeit, ist der Kern 1 bis 4 K heißer als simuliert.
effect-conductivity_temperature-meaning = Die Platte leitet Wärme heiß anders als bei Raumtemperatur.
effect-conductivity_temperature-symptom = Gegen Ende der Pressung und nach dem Öffnen entfernen sich die Seiten von der Simulation, bei dicken Platten stärker.
effect-contact_asymmetry-called = ungleicher Kontakt oben und unten
effect-contact_asymmetry-confirmed-by = Die Platte umdrehen oder die Pressbleche tauschen.
effect-contact_asymmetry-core = In der Mitte unter 1 K; die heißeste Ebene wandert aus der Mitte.
effect-contact_asymmetry-meaning = Oberer und unterer Kontakt sind in der geschlossenen Presse verschieden; der Koeffizient ist ihr geometrisches Mittel.
effect-contact_asymmetry-symptom = Nach dem Schließen liegt eine Seite über der Simulation, die andere darunter.
effect-contact_buildup-called = Kontakt, der sich nach dem Schließen aufbaut
effect-contact_buildup-confirmed-by = Mit unbeschichteten Platten und doppelter Schließgeschwindigkeit wiederholen; den Druck aufzeichnen.
effect-contact_buildup-core = Klein, einige Zehntel Kelvin, aber er verfälscht die Koeffizienten bis zum Faktor 1,8.
effect-contact_buildup-meaning = Der Kontakt zwischen Presse und Platte wächst nach dem Schließen noch einige Sekunden (das Harz schmilzt und fließt).
effect-contact_buildup-symptom = In den ersten Sekunden nach dem Schließen steigen die Seiten langsamer als simuliert, dann holen sie auf.
effect-contact_load-called = Kontakt, der vom Druck abhängt
effect-contact_load-confirmed-by = Bei drei Drücken wiederholen, alles andere gleich.
effect-contact_load-core = Unter 1 K; wichtig, wenn der Druck geändert wird.
effect-contact_load-meaning = Ein Kontakt wird mit dem Druck besser.
effect-contact_load-symptom = Die Abweichungen nach dem Schließen haben bei niedrigem und hohem Druck verschiedenes Vorzeichen.
effect-density_profile-called = Deckschichten dichter als die Mitte
effect-density_profile-confirmed-by = Das Dichteprofil messen (Röntgen) oder eine Platte mit Kernfühler pressen.
effect-density_profile-core = Der Kern liegt 1 bis 3 K daneben, weil seine Schichten weniger Wärme speichern und schlechter leiten.
effect-density_profile-meaning = Die Deckschichten der Platte sind dichter als ihre Mitte; Dichte und Wärmeleitfähigkeit folgen 1 + a (z^4 - 0,2).
effect-density_profile-symptom = Die Seiten nehmen gleich nach dem Schließen mehr Wärme auf als simuliert und später weniger.
effect-edge_loss-called = Wärmeverlust am Rand
effect-edge_loss-confirmed-by = Den Rand dämmen oder Fühler am Rand mit solchen in der Mitte vergleichen.
effect-edge_loss-core = In einer langen Pressung ist der Kern 2 bis 4 K kühler als simuliert.
effect-edge_loss-meaning = Wärme geht über den Rand der Platte verloren.
effect-edge_loss-symptom = Lange Pressungen bleiben unter der Simulation; Fühler am Rand zeigen weniger als solche in der Mitte.
effect-entry-not-an-effect = Entry Point { $name } = { $value }: kein softsensor.effects.Effect
effect-exists-already = Entry Point { $name }: einen Effekt { $effect } gibt es schon
effect-heat_capacity_offset-called = andere Wärmekapazität als angegeben
effect-heat_capacity_offset-confirmed-by = Die Platte wiegen und vermessen; ihre Wärmekapazität messen; verschiedene Dicken pressen.
effect-heat_capacity_offset-core = Der Kern ist kühler (Verhältnis über 1) oder heißer, etwa 1 K je 5 %.
effect-heat_capacity_offset-meaning = Dichte mal Wärmekapazität der Platte weicht vom Wert in den Kopfdaten ab.
effect-heat_capacity_offset-symptom = Die Seiten entfernen sich in jedem Zustand von der Simulation, bei dicken Platten zu Beginn am wenigsten.
effect-heat_capacity_temperature-called = Wärmekapazität, die von der Temperatur abhängt
effect-heat_capacity_temperature-confirmed-by = Die Wärmekapazität von 20 bis 100 °C messen (DSC) oder eine Platte mit Kernfühler pressen.
effect-heat_capacity_temperature-core = Steigt die Wärmekapazität, ist der Kern 1 bis 2 K kühler als simuliert.
effect-heat_capacity_temperature-meaning = Die Platte braucht heiß mehr Wärme je Kelvin als bei Raumtemperatur.
effect-heat_capacity_temperature-symptom = Nach dem Öffnen kühlen die Seiten langsamer ab als simuliert, während das Aufheizen passt.
effect-initial_press_state-called = Pressbleche noch nicht auf Ruhetemperatur
effect-initial_press_state-confirmed-by = Zwei Minuten zwischen Pressungen warten oder einen Fühler auf ein Pressblech kleben.
effect-initial_press_state-core = Unter 0,5 K.
effect-initial_press_state-meaning = Die Pressbleche sind noch kühler (oder wärmer) als in Ruhe, wenn die Platte eingelegt wird.
effect-initial_press_state-symptom = Die untere Seite weicht vom Einlegen an ab, und die Abweichung klingt binnen einer Minute ab.
effect-moisture_evaporation-called = verdampfende Feuchte
effect-moisture_evaporation-confirmed-by = Die Platte vor und nach dem Pressen wiegen oder eine darrtrockene pressen.
effect-moisture_evaporation-core = Sobald Dampf entsteht, wird der Kern langsamer heiß als simuliert und bleibt mehrere Kelvin darunter.
effect-moisture_evaporation-meaning = In der Platte verdampft Wasser, entweicht und nimmt seine Verdampfungswärme mit.
effect-moisture_evaporation-symptom = Die Messung steigt nahe 85 bis 115 °C nicht weiter oder bleibt zurück und liegt danach unter der Simulation.
effect-name-impossible = Effekt { $effect }: { $name } ist kein Name; er besteht aus Buchstaben von a bis z, Ziffern und _, ein Buchstabe zuerst
effect-not-in-catalogue = Effekt { $name } steht nicht im Katalog; bekannt sind { $known }
effect-open_radiation-called = Strahlung in der offenen Presse
effect-open_radiation-confirmed-by = Vor dem Schließen Aluminiumfolie zwischen Platte und oberes Blech halten.
effect-open_radiation-core = Unter 0,2 K.
effect-open_radiation-meaning = In der offenen Presse strahlt das heiße obere Blech auf die Platte.
effect-open_radiation-symptom = Die obere Seite ist in der offenen Presse wärmer als simuliert, vor dem Schließen und nach dem Öffnen.
effect-paper_layer-called = eine dämmende Papierschicht
effect-paper_layer-confirmed-by = Dieselbe Platte unbeschichtet pressen.
effect-paper_layer-core = Einige Zehntel Kelvin.
effect-paper_layer-meaning = Das imprägnierte Papier auf beiden Seiten dämmt und speichert Wärme.
effect-paper_layer-symptom = Die Seiten reagieren später als simuliert auf das Schließen, und der Koeffizient der offenen Presse wird zu klein geschätzt.
effect-parameter-limits = Effekt { $name }: Parameter { $parameter }: lower = { $lower } und upper = { $upper } sind keine Grenzen; zwei Zahlen angeben, lower die kleinere
effect-parameter-outside = Effekt { $name }: Parameter { $parameter }: { $what } = { $value } liegt außerhalb seiner Grenzen { $lower } bis { $upper }
effect-parameter-twice = Effekt { $name }: es gibt zwei Parameter { $parameter }; jedem einen eigenen Namen geben
effect-parameter-without-size = Effekt { $name }: Parameter { $parameter }: typical ist gleich neutral; der erste Parameter ist die Größe des Effekts, typical also etwas anderes als sein Fehlen
effect-parameters-missing = Effekt { $name }: seine Parameter als Tupel aus mindestens einem Parameter angeben
effect-platen_offset-called = eine falsche Heizplattenmessung
effect-platen_offset-confirmed-by = Die Heizplattenfühler bei Betriebstemperatur mit einem kalibrierten vergleichen.
effect-platen_offset-core = Etwa 0,3 K je Kelvin.
effect-platen_offset-meaning = Die Heizplattenfühler zeigen immer gleich viel zu wenig (positiv) oder zu viel (negativ).
effect-platen_offset-symptom = Am Ende einer langen Pressung weichen beide Seiten von der Simulation ab, im Verhältnis zur aufgenommenen Wärme.
effect-resin_cure-called = Wärme des aushärtenden Harzes
effect-resin_cure-confirmed-by = Dieselbe Platte ein zweites Mal pressen: ausgehärtetes Harz gibt keine Wärme mehr ab.
effect-resin_cure-core = Klein: einige Zehntel Kelvin.
effect-resin_cure-meaning = Das Harz gibt beim Aushärten an beiden Seiten Reaktionswärme ab.
effect-resin_cure-symptom = In den ersten 5 bis 30 s nach dem Schließen schießen die Seiten über die Simulation hinaus und kehren dann zurück.
effect-sensor_fault-called = ein gestörter Fühler
effect-sensor_fault-confirmed-by = Die genannten Fühler prüfen: Befestigung, Polung, Steckplatz.
effect-sensor_fault-core = Keine: der Kanal wird weggelassen.
effect-sensor_fault-meaning = Einzelne Kanäle sind lose, driften oder sind vertauscht.
effect-sensor_fault-symptom = Ein Kanal weicht von seinen Nachbarn auf derselben Seite ab.
effect-shipped = Effekt { $name }: Kerntemp bringt einen dieses Namens mit, und der bleibt; einen anderen Namen wählen
effect-terms-contacts = closed_contact ist { $found }; es sind Faktoren je Nummer eines Kontakts, 0 bis { $most }
effect-terms-fail = Effekt { $name }: seine Terme scheitern ({ $problem }); seine Werte sind { $known }
effect-terms-kinds = { $term } sind { $found }; es ist ein Tupel aus { $kind }
effect-terms-no-number = { $term } ist { $found }, keine Zahl
effect-terms-no-pair = { $term } ist { $found }; es ist ein Tupel aus zwei Zahlen
effect-terms-none = Effekt { $name }: seine Terme sind { $found }; Terms(...) zurückgeben
effect-terms-not-finite = { $term } ist nicht endlich
effect-terms-shape = { $term } hat die Form { $found }; möglich ist { $wanted }
effect-terms-wrong = Effekt { $name }: von seinen Termen gilt: { $what }
effect-thermocouple_footprint-called = Plattenfühler, die eine Mischung messen
effect-thermocouple_footprint-confirmed-by = Dünneren Draht nehmen oder einen Fühler unter Folie legen.
effect-thermocouple_footprint-core = Unter 0,1 K, aber sie verfälschen die Kontaktkoeffizienten.
effect-thermocouple_footprint-meaning = In der geschlossenen Presse messen die Plattenfühler eine Mischung aus Plattenseite und Pressblech.
effect-thermocouple_footprint-symptom = Die Messung springt beim Schließen hinauf und beim Öffnen hinab, um einen Teil des Temperatursprungs am Kontakt.
effect-thermocouple_lag-called = Plattenfühler, die verzögert messen
effect-thermocouple_lag-confirmed-by = Einen Fühler in heißes Wasser tauchen und die Sprungantwort aufzeichnen.
effect-thermocouple_lag-core = Für sich keine, aber sie verfälschen die Kontaktkoeffizienten bis zum Faktor 3.
effect-thermocouple_lag-meaning = Die Plattenfühler messen verzögert.
effect-thermocouple_lag-symptom = Die Messung hinkt der Simulation um so mehr nach, je steiler sie ist, am meisten in der Sekunde nach dem Schließen.
effect-vapour_convection-called = Dampf, der Wärme trägt
effect-vapour_convection-confirmed-by = Eine Opferplatte mit Fühler in der Mitte pressen.
effect-vapour_convection-core = Der Kern ist heißer als simuliert, meist um 2 bis 7 K.
effect-vapour_convection-meaning = In der geschlossenen Presse trägt Dampf Wärme aus Schichten über 100 °C in kühlere.
effect-vapour_convection-symptom = Die Seiten brauchen in der geschlossenen Presse mehr Wärme als simuliert; der Kern eilt um Kelvin voraus.
effect-without-words = Effekt { $name }: englische Worte fehlen für { $lacking }; in seinen `words` angeben
parameter-amount = { $value } { $unit }
parameter-clock_offset-seconds = Plattenkanäle später als Heizplattenkanäle um
parameter-conductivity_offset-ratio = Wärmeleitfähigkeit der Platte
parameter-conductivity_temperature-per_100_K = Anstieg der Wärmeleitfähigkeit je 100 K
parameter-contact_asymmetry-ratio = oberer Kontakt
parameter-contact_buildup-deficit = beim Schließen noch fehlender Anteil des Kontakts
parameter-contact_buildup-time_constant_s = Zeitkonstante seines Anstiegs
parameter-contact_load-exponent = Exponent der Druckabhängigkeit des Kontakts
parameter-density_profile-amplitude = Deckschichten dichter als die Mitte um
parameter-edge_loss-W_m3K = am Rand verlorene Wärme je Volumen und Kelvin über Umgebung
parameter-heat_capacity_offset-ratio = Wärmekapazität der Platte
parameter-heat_capacity_temperature-per_100_K = Anstieg der Wärmekapazität je 100 K
parameter-initial_press_state-offset_K = Bleche zu Beginn über ihrer Ruhetemperatur um
parameter-interval = { NUMBER($low, maximumSignificantDigits: 3) } bis { NUMBER($high, maximumSignificantDigits: 3) }
parameter-law-coldest_C = tiefste Temperatur der Kurve
parameter-law-hottest_C = höchste Temperatur der Kurve
parameter-law-last_s = späteste Zeit seit dem Schließen
parameter-law-least_load = niedrigster Druck, bezogen
parameter-law-level = Logarithmus des Faktors zur spätesten Zeit
parameter-law-most_load = höchster Druck, bezogen
parameter-law-strength = Stärke, 1 wie gefunden
parameter-law-value = Wert an der Stützstelle { $knot }
parameter-line = { $words } ({ $name }): { $amount }
parameter-line-within = { $line } (95 %: { $between })
parameter-moisture_evaporation-moisture_percent = Wasser, das verdampft
parameter-moisture_evaporation-temperature_C = Temperatur, ab der es verdampft
parameter-open_radiation-emissivity = wirksamer Emissionsgrad von Presse und Platte
parameter-paper_layer-capacity_J_m2K = Wärmekapazität des Papiers
parameter-paper_layer-resistance_m2K_W = Wärmewiderstand des Papiers
parameter-platen_offset-bottom_K = untere Heizplatte heißer als gemessen um
parameter-platen_offset-top_K = obere Heizplatte heißer als gemessen um
parameter-resin_cure-autocatalysis = Anteil der Härtungsgeschwindigkeit, der erst mit dem Härten kommt
parameter-resin_cure-heat_kJ_m2 = Reaktionswärme des Harzes
parameter-resin_cure-temperature_C = Temperatur, bei der halb gehärtetes Harz um 3 % je Sekunde härtet
parameter-thermocouple_footprint-weight = Anteil der Presse an der Messung
parameter-thermocouple_lag-time_constant_s = Zeitkonstante der Plattenfühler
parameter-vapour_convection-W_m3K = vom Dampf getragene Wärme je Volumen und Kelvin über 100 °C
place-bottom = { $body }, Unterseite
place-depth = { $body }, { NUMBER($depth_mm, maximumFractionDigits: 4) } mm über der Unterseite
place-middle = { $body }, Mitte
place-top = { $body }, Oberseite
unit-kilojoule-per-face = kJ/m² je Seite
unit-percent-of-dry-mass = % der Trockenmasse
unit-percent-of-mean = % des Mittels
unit-percent-of-value-at-20-degrees = % des Werts bei 20 °C
unit-times-nominal = mal Nennwert
unit-times-the-lower-contact = mal der untere

## softsensor.heat: the model and what a run must offer

boundary-column-missing = { $run }: die Spalte '{ $column }' fehlt; boundary.{ $end } braucht sie (die Pressung hat { $columns })
boundary-empty = { $run }: die Spalte '{ $column }' enthält keinen Wert; boundary.{ $end } braucht sie
boundary-gap = { $run }: die Spalte '{ $column }' ist { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s lang leer um time_s = { $time }; höchstens { NUMBER($most, maximumFractionDigits: 6) } s von boundary.{ $end } werden überbrückt: die Laufdatei dort teilen
boundary-impossible = { $run }: Spalte '{ $column }' = { $value } °C bei time_s = { $time }: boundary.{ $end } muss zwischen { NUMBER($lower, maximumFractionDigits: 6) } und { NUMBER($upper, maximumFractionDigits: 6) } °C liegen; die Zelle leeren
coefficient-impossible = { $where }: { $name } = { $value }: muss eine Zahl von { NUMBER($lower, maximumFractionDigits: 6) } bis { NUMBER($upper) } W/m²K sein
coefficient-missing = Koeffizient { $name } fehlt; alle angeben: { $all }
coefficient-negative = { $name } = { $value } W/m²K: muss eine endliche Zahl sein, mindestens 0
coefficient-unknown = { $where }: { $name }: die Presse „{ $press }“ hat keinen solchen Koeffizienten; sie hat { $known }
header-ambient-impossible = { $run }: Kopfdaten ambient.temperature_C = { $value }: muss eine Zahl von { NUMBER($lower, maximumFractionDigits: 6) } bis { NUMBER($upper, maximumFractionDigits: 6) } sein
header-pressure-impossible = { $run }: Kopfdaten setting.pressure_N_cm2 = { $value }: muss eine Zahl über 0 N/cm² sein; berichtigen oder, wo sie nicht bekannt ist, weglassen
header-table-not-rising = Kopfschlüssel { $key }: die Temperaturen der Tabelle steigen nicht von Zeile zu Zeile
header-table-rows = Kopfschlüssel { $key } = { $value }: eine Tabelle hat Zeilen aus Temperatur und Wert, [[20, 0.12], [100, 0.14]]
header-unseen = Kopfschlüssel { $key } = { $value }: enthält unsichtbare Zeichen; neu eintippen
header-verdict = { $key } = { $value } ist kein Urteil; eines von { $known }
layer-from-run-without-panel = Schicht '{ $layer }' nimmt ihre Werte aus der Pressung, und es gibt keine Platte
layer-incomplete = Schicht '{ $layer }': Dichte oder Dicke fehlt
live-sensor-of-press = Softsensor der Presse { $press }
live-time-no-number = Abtastung um { $time }: ihre Zeit wird in Sekunden angegeben, als Zahl; bei einer Tabelle mit Zeitpunkten als Index die Sekunden seit deren erster Zeile
live-time-not-rising = eine Messzeile bei { NUMBER($time_s, maximumFractionDigits: 3) } s nach einer bei { NUMBER($newest_s, maximumFractionDigits: 3) } s: Zeiten müssen steigen; für eine andere Pressung einen neuen LiveSensor beginnen
live-value-no-number = Spalte { $column }: { $value } ist keine Zahl; für einen fehlenden Wert NaN oder None angeben
load-column-empty = { $run }: Druckspalte '{ $column }' enthält keinen Wert über 0: { $contacts } wird als unabhängig vom Druck gerechnet; die Spalte angeben oder load aus der Pressendatei nehmen
load-column-missing = { $run }: Druckspalte '{ $column }' fehlt (vorhanden: { $columns }): { $contacts } wird als unabhängig vom Druck gerechnet; die Spalte angeben oder load aus der Pressendatei nehmen
load-gap = { $run }: Druckspalte '{ $column }' ist { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s lang leer um time_s = { $time }; höchstens { NUMBER($most, maximumFractionDigits: 6) } s eines Drucks werden überbrückt: die Laufdatei dort teilen oder die Spalte weglassen
load-impossible = { $run }: Druckspalte '{ $column }' = { $value } bei time_s = { $time }: muss eine endliche Zahl sein, nicht unter 0; die Zelle leeren oder Vorzeichen oder Nullpunkt der Spalte berichtigen
load-zero-while-closed = { $run }: Druckspalte '{ $column }' = { $value } bei time_s = { $time }, wo die Presse geschlossen ist: muss über 0 liegen; die Zelle leeren oder Vorzeichen oder Nullpunkt der Spalte berichtigen
model-file-covariance = { $file }: covariance von { $row } und { $column } = { $value }: das steht da in keiner Kovarianzmatrix; den Schlüssel covariance weglassen oder neu anpassen
model-file-covariance-of = { $file }: covariance.names nennt { $name }, wovon die Datei keinen Wert gibt; sie gibt { $known }
model-file-covariance-shape = { $file }: covariance.matrix ist { $shape }, und covariance.names hat { $names }; je Name muss sie eine Zeile und eine Spalte haben
model-file-effect-outside = { $file }: effects.{ $number }.parameters.{ $name } = { $value } ({ $effect }) liegt außerhalb der Grenzen { NUMBER($lower, maximumFractionDigits: 9) } bis { NUMBER($upper, maximumFractionDigits: 6) } { $unit }
model-file-effect-twice = { $file }: effects.{ $number }: { $effect } steht zweimal in effects; einen Eintrag behalten
model-file-effect-unnamed = { $file }: effects.{ $number } hat keinen Namen
model-file-effect-without-size = { $file }: effects.{ $number }: { $effect } hat keine Größe; unter parameters angeben: { $known }
model-file-effect-wrong = { $file }: effects.{ $number }.parameters ({ $effect }): { $what }
model-file-key-meant = { $file }: der Schlüssel '{ $key }' ist nicht bekannt; ist { $meant } gemeint?
model-file-no-coefficients = { $file }: keine Modelldatei: der Schlüssel 'coefficients' fehlt
model-file-no-json = { $file }: keine Modelldatei in JSON: { $error }
model-file-no-numbers = { $file }: { $place } = { $value }: braucht die Zahlen value und sd
model-file-no-table = { $file }: { $place } muss ein Objekt aus NAME: {"{"}value, sd{"}"} sein
model-file-of-another-press = { $path } gehört zur Presse „{ $other }“, die Pressendatei zu „{ $press }“: Koeffizienten einer anderen Presse lassen einen falschen Kern sicher aussehen; die eigenen Pressungen dieser Presse anpassen
model-file-parameter-unknown = { $file }: effects.{ $number }.parameters.{ $name }: { $effect } hat { $known }
model-file-part = { $file }: { $key } ist nicht, wie fit, diagnose und der nächtliche Lauf es schreiben; berichtigen oder den Schlüssel weglassen
model-file-scatter = { $file }: scatter.{ $key }.sd = { $value }: ein Anteil des Werts im Kopf, über 0 und höchstens { NUMBER($most, maximumSignificantDigits: 3) }, womit er von der einen seiner Grenzen zur anderen kommt
model-file-sd = { $file }: { $place }.sd = { $value }: eine Standardabweichung muss eine Zahl sein, mindestens 0
model-file-unreadable = { $file }: die Modelldatei ist nicht zu lesen: { $error }
parameter-unknown = '{ $name }' ist kein Parameter dieses Modells; es hat { $known }
run-moments-out-of-order = { $run }: { $later } = { $late } liegt vor { $earlier } = { $early }; die Spalte closed prüfen
run-ramp-impossible = { $run }: ramp_s = { $value }: das Schließen dauert eine endliche Zeit, mindestens 0 s
run-rows-far-apart = { $run }: die Reihen liegen nach time_s { NUMBER($seconds, maximumFractionDigits: 0) } s auseinander, es dürfen höchstens { NUMBER($most, maximumFractionDigits: 6) } s sein: steht time_s in Millisekunden? Nötig sind Sekunden
run-rows-missing = { $run }: keine Zeile während { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s nach time_s = { $time }; höchstens { NUMBER($most, maximumFractionDigits: 6) } s eines gemessenen Rands werden überbrückt: die Laufdatei dort teilen
run-times-fall = { $run }: time_s = { $time } folgt auf { $before } (Zeile { $row }): Zeiten müssen steigen; die Zeile berichtigen
run-too-short =
  { $run }: die Spalte time_s hat { NUMBER($rows) } { $rows ->
    [one] Zeile
   *[other] Zeilen
  }; eine Pressung braucht mindestens zwei
sensor-outside-layer = { $run }: ein Fühler bei depth_mm = { NUMBER($depth_mm, maximumFractionDigits: 6) } liegt außerhalb der Schicht '{ $layer }', die in dieser Pressung { NUMBER($thickness_mm, maximumFractionDigits: 6) } mm dick ist; seine Tiefe oder die Dicke berichtigen
solve-exact-contact-changes = method = 'exact': ein Kontakt ändert sich in der geschlossenen Presse; den impliziten Löser nehmen
solve-exact-moments-too-near = method = 'exact': weniger als vier Schritte in { NUMBER($seconds, maximumFractionDigits: 6) } s zwischen zwei Bewegungen der Presse; den impliziten Löser nehmen
solve-exact-not-linear = method = 'exact': { $what } ist nicht linear; den impliziten Löser nehmen
solve-impossible = { $run }: diese Übergänge und Quellen führen zu { $found } °C, nicht zwischen { NUMBER($coldest, maximumFractionDigits: 2) } und { NUMBER($hottest, maximumFractionDigits: 0) } °C; kein Stoff hat solche Werte, also prüfen
solve-no-temperatures = { $run }: diese Übergänge und Quellen führen zu keinen endlichen Temperaturen; kein Stoff hat solche Werte, also prüfen
solve-table-or-radiation = eine Stoffwerttabelle oder Strahlung
solve-unknown-method = method = { $method }: muss 'implicit' oder 'exact' sein
solve-value-out-of-range = { $name } = { $value }: muss eine Zahl von { NUMBER($lower, maximumFractionDigits: 6) } bis { NUMBER($upper, maximumFractionDigits: 6) } sein
start-layer-without-channel = { $run }: [initial] kind = "sensors" braucht eine Messung in der Schicht '{ $layer }', in der die Pressung keinen Kanal hat, den ein [[sensor]] der Pressendatei nennt: einen ergänzen oder kind = "steady" oder "uniform" angeben
start-layer-without-reading = { $run }: [initial] kind = "sensors" braucht eine Messung in der Schicht '{ $layer }'; leer sind { $columns }: eine füllen oder kind = "steady" oder "uniform" angeben
start-no-readings = { $run }: [initial] kind = "sensors" braucht eine Messung; alle Plattenkanäle sind leer
start-not-steady = { $run }: { $why }; [initial] kind = "uniform" mit temperature_C oder "sensors" angeben oder Ränder und Kontakte berichtigen
start-not-steady-steep = die Ruhetemperaturen sind nicht zu finden: Stoffwerte oder Strahlung ändern sich zu steil mit der Temperatur
start-not-steady-untied = Schicht '{ $layer }' tauscht mit nichts von gegebener Temperatur Wärme aus und hat darum keine Ruhetemperatur
start-not-steady-untied-without-panel = Schicht '{ $layer }' hängt ohne Platte an keiner Temperatur und hat darum keine Ruhetemperatur
value-at-least = { $name } = { $value }: muss eine endliche Zahl sein, mindestens { NUMBER($least, maximumFractionDigits: 6) }
value-at-most = { $name } = { $value }: muss eine endliche Zahl sein, höchstens { NUMBER($most, maximumFractionDigits: 6) }
value-between = { $name } = { $value }: muss eine endliche Zahl sein, mindestens { NUMBER($least, maximumFractionDigits: 6) }, höchstens { NUMBER($most, maximumFractionDigits: 6) }
value-not-finite = { $name } = { $value }: muss eine endliche Zahl sein

## softsensor.signals: channels

channel-departs = { $column } misst { NUMBER($kelvin, maximumFractionDigits: 0) } K { $side ->
    [below] unter
   *[above] über
 } den Nachbarn und wird in { $run } nicht verwendet
channel-drifting = Kanal { $column } driftet von seiner Seite weg, um { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K (RMS), und bleibt weg
channel-empty = Kanal { $column } hat keinen brauchbaren Wert und bleibt weg
channel-loose = Kanal { $column } weicht um { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K (RMS) von seiner Seite ab: Der Fühler ist womöglich lose und bleibt weg
channel-swapped = Kanal { $column } folgt einer anderen Stelle ({ $place }): vertauscht? Er bleibt weg
run-no-panel-channel =
    { $count ->
        [0] { $run }: die Pressendatei hat keinen Fühler zum Anpassen; ihr einen ohne role = "validation" geben
       *[other] { $run }: kein brauchbarer Plattenkanal; die Fühler der Pressendatei nennen { $named }
    }
run-press-state-unknown = { $run }: Pressenzustand unbekannt: kein Messwert der Platte und keine Spalte 'closed'; eine davon ergänzen oder eine Pressendatei ohne offene Kontakte nehmen

## softsensor.fitting: fits, warnings, what to measure

fit-cells-dropped =
    { $count ->
        [one] { $count } einzelner Wert wich von seiner Seite ab und blieb weg
       *[other] { $count } einzelne Werte wichen von ihrer Seite ab und blieben weg
    }
fit-cells-jump =
    { $count ->
        [one] Kanal { $column }: { $count } einzelner Wert springt um mehr als { $kelvin } K und bleibt weg
       *[other] Kanal { $column }: { $count } einzelne Werte springen um mehr als { $kelvin } K und bleiben weg
    }
fit-closed-again = ab { NUMBER($at, minimumFractionDigits: 1, maximumFractionDigits: 1) } s schließt die Presse noch einmal über derselben Platte: Zeilen von da an bleiben weg
fit-coefficient-unknown = { $name } ist { $verdict }: { $reason }
fit-coefficient-unused = { $run }: Durch ihre Kopfdaten bleibt der Koeffizient '{ $name }' der Pressendatei ungenutzt; eine Versuchsreihe braucht jeden Koeffizienten in jeder Pressung; diese Pressung einzeln anpassen
fit-fixed = in der Pressendatei festgelegt
fit-gap-at-moment =
    keine Zeilen von { NUMBER($begin, minimumFractionDigits: 1, maximumFractionDigits: 1) } s bis { NUMBER($end, minimumFractionDigits: 1, maximumFractionDigits: 1) } s; in diese Lücke fällt { $moment ->
        [inserted_s] das Einlegen
        [closed_s] das Schließen
       *[opened_s] das Öffnen
    }. Der Zeitpunkt wird innerhalb der Lücke geschätzt, was die Koeffizienten unsicherer macht
fit-misfit-astray = Residuum in Ruhe { NUMBER($rmse, minimumFractionDigits: 1, maximumFractionDigits: 1) } K nach der Anpassung, { NUMBER($first, minimumFractionDigits: 1, maximumFractionDigits: 1) } K davor
fit-misfit-lost-insertion = Einlegen und Schließen fallen in eine Lücke ihrer Zeilen, { NUMBER($begin, minimumFractionDigits: 1, maximumFractionDigits: 1) } bis { NUMBER($end, minimumFractionDigits: 1, maximumFractionDigits: 1) } s
fit-misfit-span = Residuum in Ruhe { NUMBER($rmse, minimumFractionDigits: 1, maximumFractionDigits: 1) } K bei Messwerten, die { NUMBER($span, maximumFractionDigits: 0) } K überstreichen
fit-no-run = keine Pressung angegeben; mindestens eine Datei nennen
fit-no-such-method = Verfahren '{ $method }': erlaubt sind { $methods }
fit-no-such-shared = gemeinsamer Koeffizient '{ $name }': erlaubt sind { $names }
fit-not-converged = die Suche konvergierte nicht; die Koeffizienten stehen, wo sie endete
fit-not-described = das Modell beschreibt diese Pressung nicht: { $misfit }
fit-not-described-check = das Modell beschreibt diese Pressung nicht: { $misfit }. Zu prüfen sind ihr Kopf, die Pressendatei, und ob ihre Zeilen Einlegen und Schließen zeigen
fit-nothing-to-fit = { $run }: nichts anzupassen: kein freier Koeffizient oder keine brauchbare Fühlerspalte
fit-option-averages-alone = { $option } gehört zu einem der Verfahren des Aufsatzes; auch ein Verfahren angeben
fit-option-method-unknown = { $option } { $method }: muss eins von { $known } sein
fit-option-shared-fixed = { $option } { $name }: die Pressendatei legt alle Koeffizienten fest
fit-option-shared-unknown = { $option } { $name }: muss eins von { $known } sein
fit-or-joint = Oder die gemeinsame Schätzung dieser { $runs } Pressungen nehmen.
fit-or-runs = Oder ihn aus etwa { $runs } solchen Pressungen gemeinsam bestimmen.
fit-or-share = Oder { $name } in allen Pressungen gleich annehmen (--shared { $name }).
fit-outside-allowed = { $name } = { NUMBER($value, maximumSignificantDigits: 4) } W/m²K liegt außerhalb dessen, was die Pressung zulässt, { NUMBER($low, maximumSignificantDigits: 4) } bis { NUMBER($high, maximumSignificantDigits: 4) }
fit-program = Vorhergesagt für { $settings } (95 % der Pressungen):
fit-program-beyond-limit = { $name }: Der Trend führt zu { NUMBER($value, maximumSignificantDigits: 4) } W/m²K, jenseits der Grenze { $limit } der Pressendatei, die genommen wird; vor dem Einsatz eine Pressung mit diesem Programm fahren
fit-program-coefficient = {"  "}{ $name } = { NUMBER($value, maximumSignificantDigits: 4) } W/m²K ({ NUMBER($low, maximumSignificantDigits: 4) } bis { NUMBER($high, maximumSignificantDigits: 4) })
fit-program-outside = { $name } = { $value } { $unit } liegt außerhalb der bisher gefahrenen Programme, { NUMBER($low, maximumSignificantDigits: 4) } bis { NUMBER($high, maximumSignificantDigits: 4) } { $unit }: Der Trend wird fortgesetzt; vor dem Einsatz dort eine Pressung fahren
fit-program-remark = Hinweis: { $remark }
fit-reason = { $role } { $why } { $remedy }
fit-remedy-both-sides = Beide Seiten tragen schon Fühler; kein Messwert hängt von ihm ab.
fit-remedy-calibrate-channels = Die Kanäle ({ $place }) bei zwei Temperaturen kalibrieren.
fit-remedy-calibrate-platen = Den Heizplattenkanal gegen die Plattenkanäle bei einer Temperatur kalibrieren (kerntemp calibrate).
fit-remedy-change = Die Temperaturen schneller oder weiter ändern.
fit-remedy-channels = Auch die Kanäle aufzeichnen, die dieser Pressung fehlen ({ $place }).
fit-remedy-check-channels = Die Kanäle ({ $place }) vor der Pressung gegen ein Thermometer prüfen (kerntemp calibrate).
fit-remedy-faster = Schneller messen als mit den { NUMBER($hertz, maximumSignificantDigits: 2) } Hz dieser Pressung.
fit-remedy-faster-and-switch = Schneller messen als mit den { NUMBER($hertz, maximumSignificantDigits: 2) } Hz dieser Pressung und einen Endschalter als Spalte closed aufzeichnen.
fit-remedy-go-on = Weiter messen ({ $boundary }), bis sich die Temperatur dort stärker geändert hat.
fit-remedy-hotter = Die Pressung mit heißerer Presse wiederholen; eine längere Offenzeit hilft nicht.
fit-remedy-leave-open = Die Platte vor dem Schließen eine Minute statt { NUMBER($seconds, maximumFractionDigits: 0) } s in der offenen Presse lassen.
fit-remedy-log-on = Nach dem Öffnen eine Minute weiter messen statt { NUMBER($seconds, maximumFractionDigits: 0) } s.
fit-remedy-measure-constant = { $key } an dieser Platte messen und mit { $key }.sd angeben, wie sicher der Wert ist.
fit-remedy-pressing = Eine Pressung aufzeichnen, bei der die Presse schließt.
fit-remedy-stay-closed = Die Presse länger geschlossen halten als die { NUMBER($seconds, maximumFractionDigits: 0) } s dieser Pressung.
fit-remedy-switch = Einen Endschalter als Spalte closed aufzeichnen.
fit-remedy-thermocouple = Einen Fühler auf diese Seite setzen: { $layer }, angrenzend { $other }.
fit-remedy-thermocouple-free = Einen Fühler auf die Außenseite setzen: { $layer }.
fit-role-boundary = Er wirkt hier: { $boundary }.
fit-role-closed = Er koppelt { $below } und { $above } bei geschlossener Presse ({ NUMBER($seconds, maximumFractionDigits: 0) } s in dieser Pressung).
fit-role-joined = Er koppelt { $below } und { $above }.
fit-role-open = Er koppelt { $below } und { $above } bei offener Presse ({ NUMBER($before, maximumFractionDigits: 0) } s vor dem Schließen und { NUMBER($after, maximumFractionDigits: 0) } s nach dem Öffnen in dieser Pressung).
fit-role-open-face = Er wirkt an einer freien Seite ({ $layer }) bei offener Presse ({ NUMBER($before, maximumFractionDigits: 0) } s vor dem Schließen und { NUMBER($after, maximumFractionDigits: 0) } s nach dem Öffnen in dieser Pressung).
fit-shared = ein Wert in allen Pressungen, aus allen gemeinsam bekannt
fit-shared-unknown = ein Wert in allen Pressungen, auch aus allen gemeinsam nicht bestimmt
fit-shortfall-all =
    { $more ->
        [0] Das Modell beschreibt keine dieser Pressungen: { $runs }. Sie bestimmen keinen Koeffizienten; das Modell behält die Anfangswerte der Pressendatei.
       *[other] Das Modell beschreibt keine dieser Pressungen: { $runs } und { $more } weitere. Sie bestimmen keinen Koeffizienten; das Modell behält die Anfangswerte der Pressendatei.
    }
fit-shortfall-one = Das Modell beschreibt diese Pressung nicht: { $misfit }. Sie bestimmt keinen Koeffizienten; das Modell behält die Anfangswerte der Pressendatei.
fit-shortfall-run = { $run } ({ $misfit })
fit-shortfall-some =
    Das Modell beschreibt { $count } von { $total } Pressungen nicht: { $runs }{ $more ->
        [0] .
       *[other] {" "}und { $more } weitere.
    } { $count ->
        [one] Sie bleibt bei allem Folgenden weg.
       *[other] Sie bleiben bei allem Folgenden weg.
    }
fit-start-before-insertion = Kopfzeile panel.initial_temperature_C = { $header }, aber die Plattenkanäle zeigen { NUMBER($read, minimumFractionDigits: 1, maximumFractionDigits: 1) } °C vor dem Einlegen: Die Koeffizienten beruhen darauf; den Kopf oder die Kanäle berichtigen
fit-start-in-first-row = Kopfzeile panel.initial_temperature_C = { $header }, aber die Plattenkanäle zeigen { NUMBER($read, minimumFractionDigits: 1, maximumFractionDigits: 1) } °C in der ersten Zeile: Die Koeffizienten beruhen darauf; den Kopf oder die Kanäle berichtigen
fit-stuck = steckengeblieben: Das Verfahren endet { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K (RMS) von den Messwerten; mit den Schätzwerten waren es { NUMBER($first, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, und das übliche Verfahren erreicht { NUMBER($own, minimumFractionDigits: 2, maximumFractionDigits: 2) } K
fit-two-sentences = { $first } { $second }
fit-unknown-closing = dem Zeitpunkt des Schließens
fit-unknown-constant = dem Kennwert { $place } aus Kopf oder Pressendatei
fit-unknown-gain = der Verstärkung der Kanäle ({ $place })
fit-unknown-insertion = dem Zeitpunkt des Einlegens
fit-unknown-offset = dem Versatz der Kanäle ({ $place })
fit-unknown-opening = dem Zeitpunkt des Öffnens
fit-unknown-platen-bottom = dem Fehler des unteren Heizplattenkanals
fit-unknown-platen-top = dem Fehler des oberen Heizplattenkanals
fit-unknown-ramp = der Schließzeit der Presse
fit-unknown-skew =
    { $place ->
        [all] der Verzögerung der Plattenkanäle
       *[other] der Verzögerung der Kanäle ({ $place })
    }
fit-unknown-start = der Anfangstemperatur der Platte
fit-verdict-fixed = festgelegt
fit-verdict-identifiable = bestimmbar
fit-verdict-not-identifiable = nicht bestimmbar
fit-verdict-one-sided = nur nach einer Seite begrenzt
fit-verdict-shared = gemeinsam
fit-why-noise = Seine Wirkung von { NUMBER($kelvin, maximumSignificantDigits: 2) } K geht im langsamen Rauschen der Seiten ({ NUMBER($noise, maximumSignificantDigits: 2) } K) unter.
fit-why-resistance = Jeder Wert über { NUMBER($least, maximumSignificantDigits: 3) } W/m²K passt ebenso: Sein Widerstand, unter { NUMBER($resistance, maximumSignificantDigits: 1) } m²K/W, ist zu klein, um gesehen zu werden.
fit-why-together = Er ist mit { $partner } korreliert (Korrelation { NUMBER($correlation, minimumFractionDigits: 2, maximumFractionDigits: 2) }).
fit-why-unseen = Kein Messwert dieser Pressung ändert sich um mehr als { NUMBER($kelvin, maximumSignificantDigits: 2) } K, wenn er um den Faktor 2,7 wächst.
fit-why-wide = Er ist nur auf einen Faktor { NUMBER($factor, minimumFractionDigits: 1, maximumFractionDigits: 1) } bekannt.

## softsensor.diagnosis: verdicts, causes, what to measure next

core-largest-shift = Im Verlauf einer Pressung ist er bis zu { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K { $change ->
        [hotter] heißer
       *[cooler] kühler
    }.
core-no-panel = In diesem Aufbau liegt keine Platte, es gibt also keinen Kern.
core-not-proven = Fühler an den Seiten können den Kern nicht bestätigen; dazu einige Platten mit Kernfühler pressen.
core-off = Kernfühler, die in keine Anpassung eingingen, liegen { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K daneben.
core-press-time = Für die Kerntemperatur, die das einfache Modell vorhersagte, { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s { $change ->
        [longer] länger
       *[shorter] kürzer
    } pressen (mittlere Pressung).
core-shift = { $at ->
        [opening] Beim Öffnen der Presse
       *[end] Am Ende einer Pressung
    } ist der Kern { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K { $change ->
        [hotter] heißer
       *[cooler] kühler
    } als nach dem einfachen Modell (± { NUMBER($sd, minimumFractionDigits: 1, maximumFractionDigits: 1) } K von Pressung zu Pressung).
core-thermocouples = Kernfühler, die in keine Anpassung eingingen, liegen { NUMBER($before, minimumFractionDigits: 1, maximumFractionDigits: 1) } K neben dem einfachen und { NUMBER($after, minimumFractionDigits: 1, maximumFractionDigits: 1) } K neben dem erweiterten Modell.
core-unchanged = Es kam keine Ursache hinzu, die Kernschätzung bleibt also, wie sie ist.
diagnosis-no-runs = keine Pressungen für die Diagnose; mindestens eine Laufdatei angeben
diagnosis-verdict-ambiguous = Ursache eingegrenzt
diagnosis-verdict-failed = gescheitert
diagnosis-verdict-named = Ursache benannt
diagnosis-verdict-no_effect = kein Effekt
diagnosis-verdict-not_described = das Modell beschreibt die Pressungen nicht
diagnosis-verdict-too_few_runs = zu wenige Pressungen
diagnosis-verdict-unknown_effect = unbekannter Effekt
gain-hardly = { $causes ->
        [one] Damit
       *[other] Mit ihnen
    } ändert sich das Residuum kaum: von { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } auf { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K auf ausgelassenen Pressungen.
gain-more-is-missing = Rauschen allein macht { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, es fehlt also noch etwas, das diese Pressungen nicht benennen können.
gain-residual-falls = { $causes ->
        [one] Damit
       *[other] Mit ihnen
    } fällt das Residuum auf ausgelassenen Pressungen von { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } auf { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K.
measured-at = { $at } °C
measured-between = { $low } bis { $high } °C
next-confirm-and-core = Um den Kern zu kennen, zwei oder drei Opferplatten mit Kernfühler pressen; um die Ursache zu bestätigen: { $confirm }
next-constants = Wärmeleitfähigkeit und Wärmekapazität der Platte messen: die Seiten passen, aber die Kernfühler liegen { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K daneben, es gibt also einen Fehler, den die Seiten nicht zeigen.
next-describe = Dicken, Materialien und Spalten von Pressendatei und Pressungen prüfen, dann eine Platte mit Kernfühler pressen.
next-describe-rig = Dicken, Materialien und Spalten von Pressendatei und Messungen prüfen, dann einmal mit einem Fühler in einer Schicht messen.
next-look-there = Drei Opferplatten mit Kernfühler pressen und die aufgeführten Zeiten und Stellen ansehen.
next-look-there-rig = Noch einmal messen, mit einem Fühler an den aufgeführten Stellen und zu den aufgeführten Zeiten.
next-more-runs = Mindestens { $more ->
        [one] eine weitere Platte
       *[other] { $more } weitere Platten
    } pressen, mit verschiedenen Presszeiten und möglichst Dicken: unter { $least } Pressungen ist eine Ursache nicht vom Zufall zu unterscheiden.
next-more-runs-rig = Mindestens { $more ->
        [one] eine weitere Messung
       *[other] { $more } weitere Messungen
    } mit anderem Temperaturverlauf machen: unter { $least } Messungen ist eine Ursache nicht vom Zufall zu unterscheiden.
next-none = Keine nötig; ein Kernfühler in einer Opferplatte im Monat würde den Kern bestätigen.
next-none-confirmed = Keine nötig: Kernfühler bestätigen es (vorher { NUMBER($before, minimumFractionDigits: 1, maximumFractionDigits: 1) } K daneben, nachher { NUMBER($after, minimumFractionDigits: 1, maximumFractionDigits: 1) } K).
next-none-rig = Keine nötig.
next-tell-apart = Um diese Ursachen zu unterscheiden ({ $causes }): { $confirm }
next-those-runs = Herausfinden, worin sich die Pressungen, in denen mehr als Rauschen bleibt, von den anderen unterscheiden, und sie für sich diagnostizieren{ $more ->
        [0] .
        [one] , zusammen mit einer weiteren dieser Art: unter { $least } Pressungen ist eine Ursache nicht vom Zufall zu unterscheiden.
       *[other] , zusammen mit { $more } weiteren dieser Art: unter { $least } Pressungen ist eine Ursache nicht vom Zufall zu unterscheiden.
    }
note-cells-jump = { $count } von { $runs } Pressungen: { $cells ->
        [one] ein einzelner Wert von { $column } springt um mehr als { $kelvin } K und wurde weggelassen
       *[other] { $cells } einzelne Werte von { $column } springen um mehr als { $kelvin } K und wurden weggelassen
    }
note-channel = { $run }: { $column } ist { $kind ->
        [swapped] vertauscht
        [drifting] gedriftet
       *[loose] lose
    } ({ NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K RMS) und wurde weggelassen
note-channel-in-runs = { $count } von { $runs } Pressungen: { $column } ist { $kind ->
        [swapped] vertauscht
        [drifting] gedriftet
       *[loose] lose
    } ({ NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K RMS) und wurde weggelassen
note-left-in-runs = mehr als Rauschen bleibt in { $count } von { $runs } Pressungen, dort { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, in den anderen { NUMBER($rest, minimumFractionDigits: 2, maximumFractionDigits: 2) } K: { $names }
note-refuted-by-cores = Kernfühler schließen diese Ursache aus, obwohl die Seiten passen würden: { $cause }
note-rim-falls = Fühler am Rand fallen im Verlauf einer Pressung um { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K gegen die in der Mitte: dort geht Wärme verloren
note-thickness-alike = Platten von { NUMBER($thickness, minimumFractionDigits: 1, maximumFractionDigits: 1) } mm statt der { NUMBER($given, minimumFractionDigits: 1, maximumFractionDigits: 1) } mm der Kopfdaten zeigten dasselbe: eine nachmessen
p-value = p = { NUMBER($p, maximumSignificantDigits: 2) }
p-value-below = p < { NUMBER($p, maximumSignificantDigits: 1) }
p-value-few-runs = { $chance } ({ $runs } { $runs ->
        [one] Pressung kann
       *[other] Pressungen können
    } nicht weniger als { NUMBER($least, maximumSignificantDigits: 2) } zeigen; benannt, weil jede ausgelassene Pressung damit besser passt und das übrige Residuum sich mindestens halbiert)
phase-after-opening = nach dem Öffnen
phase-before-closing = vor dem Schließen
phase-closed = geschlossen
phase-since-run-began = seit Beginn der Pressung
verdict-alike = Diese Pressungen können folgende Ursachen nicht unterscheiden: { $causes }.
verdict-cores-off = Das einfache Modell erklärt die Seiten dieser { $runs } Pressungen auf { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, bei { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K Rauschen, doch ihre Kernfühler liegen { NUMBER($core, minimumFractionDigits: 1, maximumFractionDigits: 1) } K daneben, in allen Pressungen gleich: es fehlt etwas, das die Seiten nicht zeigen.
verdict-differs-from-run-to-run = Diese { $runs } Pressungen haben keine Ursache gemeinsam, und doch liegt das einfache Modell { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K daneben, bei { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K Rauschen: was fehlt, ist von Pressung zu Pressung verschieden.
verdict-faulty-channels = Lose, gedriftet oder vertauscht und weggelassen: { $columns }.
verdict-few-runs = { $runs } { $runs ->
        [one] Pressung ist
       *[other] Pressungen sind
    } zu wenig, um eine Ursache vom Zufall zu unterscheiden.
verdict-few-runs-for-others = { $runs } { $runs ->
        [one] Pressung ist
       *[other] Pressungen sind
    } zu wenig, um eine andere Ursache vom Zufall zu unterscheiden.
verdict-few-runs-off = { $runs } { $runs ->
        [one] Pressung ist
       *[other] Pressungen sind
    } zu wenig, um eine Ursache vom Zufall zu unterscheiden; das einfache Modell liegt { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K daneben, davon sind { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K Rauschen.
verdict-left = { $who ->
        [some] Einige der Pressungen
       *[all] Alle Pressungen
    } haben ein Residuum gemeinsam, das keine Ursache des Katalogs erklärt.
verdict-left-at = { $who ->
        [some] Einige der Pressungen
       *[all] Alle Pressungen
    } haben ein Residuum gemeinsam, das keine Ursache des Katalogs erklärt: { $stretch }.
verdict-not-described = Kein Urteil möglich: das Modell liegt { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K daneben, Rauschen allein macht { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K. Pressendatei, Kopfdaten der Pressungen und die Zuordnung der Spalten prüfen.
verdict-panels-differ = Das einfache Modell erklärt diese { $runs } Pressungen auf { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, bei { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K Rauschen, doch nur, wenn ihre Platten sich stärker voneinander unterscheiden als Platten eines Erzeugnisses: etwas Unbekanntes ist von Pressung zu Pressung verschieden.
verdict-panels-not-as-given = Das einfache Modell erklärt diese { $runs } Pressungen auf { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, bei { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K Rauschen, doch nur, wenn alle ihre Platten anders leiten oder speichern als in den Kopfdaten angegeben, stärker als Platten eines Erzeugnisses es tun. Dicke, Dichte, Wärmeleitfähigkeit und Wärmekapazität prüfen.
verdict-plain-model-explains = Das einfache Modell erklärt diese { $runs } Pressungen auf { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K; Rauschen allein macht { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K.
verdict-plain-model-explains-the-rest = Ohne sie erklärt das einfache Modell diese { $runs } Pressungen auf { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K.
verdict-something-beyond-chance = Das einfache Modell erklärt diese { $runs } Pressungen auf { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, bei { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K Rauschen, und doch passt eine Ursache besser als durch Zufall. Dass sie ausgelassene Pressungen verbessert, ist nicht gezeigt.
verdict-suspected = Verdacht, nicht bewiesen: { $causes }.
where-further = Dann: { $stretch }.
where-most = Am weitesten daneben: { $stretch }.
where-stretch = { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K { $side ->
        [above] über
       *[below] unter
    } dem einfachen Modell gemessen, { $place }, von { $begin } bis { $end } s ({ $phase }), bei { $temperatures }
where-stretch-to-the-end = { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K { $side ->
        [above] über
       *[below] unter
    } dem einfachen Modell gemessen, { $place }, ab { $begin } s ({ $phase }), bei { $temperatures }
worth-core = der Kern ist { $at ->
        [opening] beim Öffnen der Presse
       *[end] am Ende einer Pressung
    } { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K { $change ->
        [hotter] heißer
       *[cooler] kühler
    }
worth-faulty-channel = durch Vergleich mit den Kanälen daneben gefunden und weggelassen
worth-hardly = senkt das Residuum auf ausgelassenen Pressungen kaum ({ NUMBER($gain, minimumFractionDigits: 2, maximumFractionDigits: 2) } von { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K); benannt, weil { $better } von { $runs } Pressungen, jede einmal ausgelassen, damit besser passen; es { $moved }, und { $core }
worth-hardly-without-panel = senkt das Residuum auf ausgelassenen Pressungen kaum ({ NUMBER($gain, minimumFractionDigits: 2, maximumFractionDigits: 2) } von { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K); benannt, weil { $better } von { $runs } Pressungen, jede einmal ausgelassen, damit besser passen; es { $moved }
worth-moves = { $change ->
        [raises] hebt
       *[lowers] senkt
    } { $coefficient } ({ $bodies }) um { NUMBER($percent, maximumFractionDigits: 0) } %
worth-moves-nothing = ändert keinen Koeffizienten über den Zufall hinaus
worth-saves = senkt das Residuum einer typischen ausgelassenen Pressung um { NUMBER($gain, minimumFractionDigits: 2, maximumFractionDigits: 2) } K (geometrisches Mittel über die Pressungen)

## softsensor.diagnosis.laws: what is missing as a free function

law-alike = Diese Pressungen können es nicht unterscheiden von: { $others }.
law-axis-depth_share = Höhe in der Platte, als Anteil ihrer Dicke
law-axis-load_share = Druck, als Anteil seines Bezugs
law-axis-temperature_C = Temperatur [°C]
law-axis-time_since_closing_s = Zeit seit dem Schließen [s]
law-changes = Über den Bereich, den die Pressungen durchliefen, { $change ->
        [falls] fällt
       *[rises] steigt
    } er zwischen { NUMBER($begin, maximumSignificantDigits: 3) } und { NUMBER($end, maximumSignificantDigits: 3) } um { NUMBER($percent, maximumFractionDigits: 0) } %.
law-core = { $at ->
        [opening] Beim Öffnen der Presse
       *[end] Am Ende einer Pressung
    } ist der Kern dadurch { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K { $change ->
        [hotter] heißer
       *[cooler] kühler
    }.
law-ends = { $low } = { NUMBER($least, maximumSignificantDigits: 6) } muss unter { $high } = { NUMBER($most, maximumSignificantDigits: 6) } liegen
law-found = Es fehlt, ohne Namen: { $kind }, nach { $variable }, von { NUMBER($least, maximumSignificantDigits: 3) } (bei { NUMBER($at_least, maximumSignificantDigits: 3) }; 95 %: { NUMBER($least_low, maximumSignificantDigits: 3) } bis { NUMBER($least_high, maximumSignificantDigits: 3) }) bis { NUMBER($most, maximumSignificantDigits: 3) } (bei { NUMBER($at_most, maximumSignificantDigits: 3) }; 95 %: { NUMBER($most_low, maximumSignificantDigits: 3) } bis { NUMBER($most_high, maximumSignificantDigits: 3) }){ $unit }; das spart { NUMBER($gain, minimumFractionDigits: 2, maximumFractionDigits: 2) } von { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K bei ausgelassenen Pressungen.
law-heading = Was fehlt, ohne Namen
law-heat = Zwischen { NUMBER($begin, maximumFractionDigits: 0) } und { NUMBER($end, maximumFractionDigits: 0) } °C { $change ->
    [goes] verschwindet
   *[comes] entsteht
} Wärme, { NUMBER($amount, maximumSignificantDigits: 2) } kJ je kg Platte (95 %: { NUMBER($least, maximumSignificantDigits: 2) } bis { NUMBER($most, maximumSignificantDigits: 2) }){ $change ->
    [goes] : Verdampfung oder ein Phasenübergang täte das.
   *[comes] : eine Reaktion täte das.
}
law-kind-conductivity = Faktor auf die Wärmeleitfähigkeit der Platte
law-kind-contact = Faktor auf die geschlossenen Kontakte der Platte
law-kind-contact_by_load = Faktor auf die geschlossenen Kontakte der Platte, wenn sich der Druck ändert
law-kind-contact_by_temperature = Faktor auf die geschlossenen Kontakte der Platte, wenn sich ihre Flächen erwärmen
law-kind-contact_lower = Faktor auf den geschlossenen Kontakt der unteren Fläche
law-kind-contact_upper = Faktor auf den geschlossenen Kontakt der oberen Fläche
law-kind-heat = Wärme, die beim Erwärmen der Platte verbraucht und beim Abkühlen nicht frei wird
law-kind-heat_exchange = Wärme, die je Volumen an den Raum geht
law-kind-source_by_depth = Wärme, die bei geschlossener Presse in der Platte frei wird
law-kind-source_by_time = Wärme, die seit dem Schließen überall in der Platte frei wird
law-lacks = { $name } fehlt, und alle Zahlen eines Gesetzes gehören zusammen; aus der Datei nehmen, die diagnose schrieb
law-none = Kein freies Gesetz: bei keinem ist sicher, dass es ausgelassene Pressungen verbessert.
law-resembles = In seinem Band stimmt er mit der Kurve einer bekannten Ursache überein: { $cause }.
law-variable-depth_share = Höhe in der Platte (0 unten, 1 oben)
law-variable-load_share = Druck als Anteil seines Bezugs
law-variable-temperature_C = Temperatur in °C
law-variable-time_since_closing_s = Zeit seit dem Schließen in s

## softsensor.diagnosis.rehearsal: error rates of a campaign

rehearsal-alone = allein genannt
rehearsal-begins = Probe mit { $runs } Pressungen: { $campaigns } simulierte Versuchsreihen zu diagnostizieren, { $done } schon fertig. Sie stammen aus dem eigenen Modell des Softsensors, mit Programmen, Rauschen und Streuung dieser Pressungen.
rehearsal-count = { $name } = { $value }: eine ganze Zahl ab 1 angeben
rehearsal-counted = { $count } von { $of }
rehearsal-file-other = { $path }: enthält anderes als fertige Versuchsreihen einer Probe; eine neue Datei angeben oder die einer früheren Probe
rehearsal-found = gefunden
rehearsal-heading = Wie oft eine solche Diagnose richtig ist
rehearsal-lost = { $count ->
    [one] { $count } der Versuchsreihen fehlt und zählt
   *[other] { $count } der Versuchsreihen fehlen und zählen
} nirgends mit: Die Prozesse, die sie simulierten, wurden abgebrochen.
rehearsal-none = Ohne verborgene Ursache wird in { $rate } der Versuchsreihen eine genannt.
rehearsal-not-testable = { $name }: diese Pressungen können sie nicht zeigen; wählbar sind { $known }
rehearsal-options-alone = --rehearse-campaigns, --rehearse-effect, --rehearse-file und --dask gehören zu --rehearse; es mit angeben
rehearsal-own-model = Die Versuchsreihen sind mit dem eigenen Modell des Softsensors simuliert: Die Anteile gelten für eine Presse, die es bis auf die eine Ursache beschreibt. Was eine wirkliche Presse sonst noch tut, verschlechtert sie.
rehearsal-rate = { $count } von { $of } ({ NUMBER($low, maximumFractionDigits: 0) } bis { NUMBER($high, maximumFractionDigits: 0) } %)
rehearsal-size = { $name }={ $size }: die Größe muss eine Zahl von { $low } bis { $high } sein
rehearsal-size-cell = { $value } { $unit }
rehearsal-size-head = Größe
rehearsal-size-none = { $name }={ $size }: in dieser Größe ist die Ursache nicht vorhanden; Versuchsreihen ohne verborgene Ursache werden ohnehin geprobt
rehearsal-takes = Das dauert etwa { NUMBER($minutes, maximumFractionDigits: 0) } min mit { $workers } { $workers ->
    [one] Prozess
   *[other] Prozessen
}.
rehearsal-title = Versuchsreihen aus { $runs } Pressungen wie diesen, je mit einer verborgenen Ursache: wie viele davon sie finden, mit 95-%-Intervallen.
rehearsal-wrong = andere Ursache genannt

## softsensor.planning: the next pressings

advise-assumed = Angenommen: die Heizplatten halten ihren Sollwert; was sie nach außen verlieren, ist nicht gezählt. Wann zu öffnen ist, entscheidet der Softsensor im Betrieb.
advise-best = { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s bei { NUMBER($platen, maximumFractionDigits: 0) } °C pressen: alle Grenzen gelten mit einer Wahrscheinlichkeit von { NUMBER($percent, maximumFractionDigits: 1) } %
advise-cure-without-resin = eine Grenze der Aushärtung braucht die Kinetik des Harzes; auch eine Harzdatei angeben
advise-energy = { NUMBER($energy, maximumFractionDigits: 3) } kWh je Platte, { NUMBER($panels, maximumFractionDigits: 0) } Platten in der Stunde
advise-energy-cost = { $energy }, { NUMBER($cents, maximumFractionDigits: 1) } Cent je Platte
advise-goal-unknown = Ziel { $goal }: muss eines von { $known } sein
advise-limit-core_least = Kern zu kalt
advise-limit-core_most = Kern zu heiß
advise-limit-cure_bottom = untere Seite nicht ausgehärtet
advise-limit-cure_top = obere Seite nicht ausgehärtet
advise-limit-steam_most = zu viel Dampf
advise-load-unit = Presse { $press }: das Modell folgt der Last in Spalte { $column }, deren Einheit nirgends steht: beim Kontakt in load unit = "N/cm2", "kPa", "bar" oder "MPa" angeben
advise-margin = Die Hälfte der Platten ist nach { NUMBER($likely, minimumFractionDigits: 1, maximumFractionDigits: 1) } s fertig; bis { NUMBER($until, maximumFractionDigits: 0) } s gelten alle Grenzen mit der gewünschten Wahrscheinlichkeit.
advise-measure = Wäre dies genau bekannt, genügten { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s: { $source }
advise-no-limit = keine Grenze angegeben; eine Harzdatei mit [limits] angeben, oder was der Kern mindestens oder höchstens erreichen soll
advise-none = Kein Programm in den Bereichen hält alle Grenzen ein. Am nächsten: Heizplatten { NUMBER($platen, maximumFractionDigits: 0) } °C, eine Grenze mit einer Wahrscheinlichkeit von { NUMBER($percent, maximumFractionDigits: 0) } % verletzt, am ehesten: { $limit }
advise-panel = Platte: { $material }, { $thickness } mm
advise-panel-unreadable = --panel '{ $given }': muss SCHLÜSSEL=WERT sein, etwa panel.thickness_mm=16
advise-press-time-narrow = Bereich von press_time_s, { NUMBER($low, maximumFractionDigits: 3) } bis { NUMBER($high, maximumFractionDigits: 3) }: Presszeiten werden in Schritten von { NUMBER($step) } s geprüft, und keine liegt im Bereich; ihn weiten
advise-press-without-states = { $press }: nach der Pressendatei öffnet und schließt nichts, also gibt es keine Presszeit
advise-pressure = Druck: { NUMBER($pressure, maximumFractionDigits: 0) } N/cm²
advise-pressure-unknown = Bereich von { $name }: das Modell weiß nicht, was der Druck bewirkt, denn nichts in ihm folgt einer Last; weglassen, oder zuerst Pressungen mit verschiedenem Druck diagnostizieren
advise-source-coefficients = die Kontakte dieser Pressung (der Softsensor lernt sie beim Pressen; gleichmäßige Kontakte helfen)
advise-source-effects = die Größe der gefundenen Ursachen (mehr Pressungen)
advise-source-kinetics = die Kinetik des Harzes (eine DSC dieses Papiers)
advise-source-platens = die wahre Temperatur der Heizplatten (kalibrieren)
advise-source-sorption = die Isotherme der Platte (ein Sorptionsversuch)
advise-steam-without-moisture = eine Grenze für Dampf braucht die Feuchte der Platte; { $key } bei der Platte angeben oder steam_most_kPa aus den Grenzen nehmen
plan-best = Am besten: { $settings }. { $prospect }
plan-best-is-usual = Am besten: die üblichen Einstellungen. { $prospect }
plan-heading = Die nächsten Pressungen, die am meisten bringen
plan-narrows-factor = Eine Pressung bringt es auf einen Faktor { NUMBER($factor, maximumFractionDigits: 2) }; { $runs }.
plan-narrows-kelvin = Eine Pressung bringt es auf ±{ NUMBER($kelvin, maximumFractionDigits: 2) } K; { $runs }.
plan-not-described = Das Modell beschreibt diese Pressungen nicht; was eine weitere Pressung brächte, ist nicht vorherzusagen.
plan-nothing-open = Keine Frage bleibt offen, die eine Pressung klären könnte.
plan-open-causes = Nicht zu unterscheiden: { $causes }
plan-open-coefficient = { $name } ist bis auf einen Faktor { NUMBER($factor, maximumFractionDigits: 2) } nach oben und unten bekannt (gewünscht: { NUMBER($wanted, maximumFractionDigits: 2) })
plan-open-core = Der Kern beim Öffnen ist auf ±{ NUMBER($kelvin, maximumFractionDigits: 1) } K bekannt, soweit alle Pressungen es gemeinsam haben (gewünscht: ±{ NUMBER($wanted, maximumFractionDigits: 1) } K)
plan-open-suspected = Im Verdacht, nicht bewiesen: { $causes }
plan-range-unknown = Bereich von { $name }: diese Einstellung gibt es hier nicht; bekannt sind { $known }
plan-range-unreadable = --range '{ $given }': muss NAME=UNTEN:OBEN sein, etwa thickness_mm=8:19
plan-range-wrong = Bereich von { $name }, { NUMBER($low, maximumFractionDigits: 3) } bis { NUMBER($high, maximumFractionDigits: 3) }: das untere Ende zuerst angeben; beide müssen zwischen { NUMBER($lower, maximumFractionDigits: 3) } und { NUMBER($upper, maximumFractionDigits: 3) } liegen
plan-repeated = Die üblichen Einstellungen noch einmal: { $prospect }
plan-runs = { $runs ->
    [one] { $runs } genügt
   *[other] { $runs } genügen
}
plan-runs-too-many = auch { $many } genügen nicht
plan-set-as-usual = die üblichen Einstellungen
plan-set-platen_temperature_C = Heizplatten { NUMBER($value, maximumFractionDigits: 0) } °C
plan-set-press_time_s = Presszeit { NUMBER($value, maximumFractionDigits: 0) } s
plan-set-pressure_N_cm2 = Druck { NUMBER($value, maximumFractionDigits: 0) } N/cm²
plan-set-start_temperature_C = Platte mit { NUMBER($value, maximumFractionDigits: 0) } °C
plan-set-thickness_mm = Platte von { NUMBER($value, maximumFractionDigits: 1) } mm
plan-set-waiting_s = vor dem Schließen { NUMBER($value, maximumFractionDigits: 0) } s offen
plan-setting-unknown = { $name }: diese Einstellung hat die Pressung nicht; sie hat { $known }
plan-setting-wrong = { $name } = { $value } muss zwischen { $lower } und { $upper } liegen
plan-settles = Eine Pressung klärt es mit { NUMBER($percent, maximumFractionDigits: 0) } % Wahrscheinlichkeit; { $runs }.
plan-settles-surely = Eine Pressung klärt es so gut wie sicher: mit über 99 % Wahrscheinlichkeit.
plan-until-of-diagnosis = until: eine Diagnose hat ihre Pressungen schon; until bei diagnose angeben oder plan die Pressungen selbst geben
plan-with-core = Mit einem Fühler im Kern: { $settings }. { $prospect }
what-if-too-long = eine Pressung von mehr als { NUMBER($most, maximumFractionDigits: 0) } s wird nicht simuliert; eine kürzere Presszeit wählen

## softsensor.live: why the core is not valid

blisters-bear = Die Hälfte der Platten hält { NUMBER($most, maximumFractionDigits: 0) } kPa Dampf aus (95 %: { NUMBER($low, maximumFractionDigits: 0) } bis { NUMBER($high, maximumFractionDigits: 0) }).
blisters-foreseen = Spätere Platten, jede aus den vor ihr markierten vorhergesagt: Was aus ihnen wurde, hatte im Mittel eine Wahrscheinlichkeit von { NUMBER($learned, maximumFractionDigits: 0) } %, nach der angegebenen Grenze { NUMBER($stated, maximumFractionDigits: 0) } %.
blisters-keep = Diese beiden ebenfalls ablegen, damit dieselben Platten nicht zweimal zählen: steam_believed_kPa = { NUMBER($believed, maximumFractionDigits: 2) }, steam_believed_kPa.sd = { NUMBER($sd, maximumFractionDigits: 2) }
blisters-marks = { $marks ->
        [one] Eine markierte Platte
       *[other] { $marks } markierte Platten
    }, deren Dampf beim Öffnen bekannt ist, { $blistered } mit Blasen.
blisters-write = Für [limits] der Harzdatei: steam_most_kPa = { NUMBER($most, maximumFractionDigits: 0) }, steam_most_kPa.sd = { NUMBER($sd, maximumFractionDigits: 0) }
core-may-pass-limit-soon = der Kern kann in { NUMBER($seconds, maximumFractionDigits: 0) } s { NUMBER($limit_C, maximumFractionDigits: 1) } °C überschreiten: Presse öffnen
core-will-pass-limit = der Kern wird bis auf { NUMBER($peak_C, maximumFractionDigits: 0) } °C steigen, über die Grenze von { NUMBER($limit_C, maximumFractionDigits: 1) } °C
core-will-pass-limit-even-if-opened = der Kern wird { NUMBER($peak_C, maximumFractionDigits: 0) } °C erreichen, selbst wenn die Presse jetzt öffnet, über der Grenze von { NUMBER($limit_C, maximumFractionDigits: 1) } °C
reason-another-panel = Plattendicke zweifelhaft: { NUMBER($header_mm, maximumFractionDigits: 1) } mm in den Kopfdaten, { NUMBER($nearest_mm, maximumFractionDigits: 1) } mm in der nächsten früheren Pressung dieser Presse; das Band über beide ist breiter als ±{ NUMBER($limit_K, maximumFractionDigits: 0) } K; die Dicke in den Kopfdaten prüfen
reason-band-too-wide = Kern nicht bestimmbar: das Band ist breiter als ±{ NUMBER($limit_K, maximumFractionDigits: 0) } K
reason-calculation-failed = die Rechnung ist fehlgeschlagen und wird neu gestartet
reason-clock-ahead = die Messzeilen tragen eine Zeit, die der Uhr dieses Rechners { NUMBER($ahead_s, maximumFractionDigits: 0) } s voraus ist: Uhren stellen
reason-constants-far-from-the-material = die Stoffwerte der Platte sind nicht besser als auf 50 % bekannt: die der Kopfdaten liegen weit neben denen des Materials, oder die letzten Pressungen hatten sie weit neben den Kopfdaten; berichtigen oder angeben, wie sicher sie sind (KEY.sd)
reason-core-impossible = der berechnete Kern hat { NUMBER($core_C, maximumFractionDigits: 0) } °C, was unmöglich ist: nichts unter { NUMBER($lowest_C, maximumFractionDigits: 0) } °C oder über { NUMBER($highest_C, maximumFractionDigits: 0) } °C hat die Platte berührt
reason-estimate-behind-the-press = die Presse hat sich eben bewegt, und der Softsensor ist noch nicht so weit
reason-faces-jumped-during-a-gap = die Temperatur beider Seiten ist während einer Messlücke gesprungen
reason-faces-too-cold-for-this-panel = die Seiten sind viel kälter als die der gepressten Platte; es kann eine andere Platte dort liegen
reason-insertion-not-seen = Kern nicht bestimmbar: nichts hat gezeigt, wann die Platte eingelegt wurde
reason-live-sensor-silent = der Softsensor hat seit { SPAN($silent_s) } keine Schätzung geliefert
reason-no-estimate-yet = der Softsensor hat noch keine Schätzung geliefert
reason-no-panel-in-the-press = keine Platte in der Presse
reason-no-reading-of-the-lower-face = Kern nicht bestimmbar: kein Fühler der Unterseite zeigt, ob eine Platte in der Presse liegt
reason-no-scans = seit { SPAN($silent_s) } keine Messzeile
reason-not-published = im Augenblick veröffentlicht es niemand
reason-panel-not-seen-in-the-open-press = seit Langem zeigt kein Fühler, ob die Platte noch in der offenen Presse liegt
reason-platen-reading-missing = Heizplattentemperatur fehlt
reason-platen-reading-missing-at-insertion = die Heizplattentemperaturen fehlten, als die Platte eingelegt wurde
reason-press-closed-again-on-the-same-panel = die Presse hat sich über derselben Platte noch einmal geschlossen
reason-press-closed-during-a-gap = die Presse schloss während einer langen Messlücke
reason-press-state-unknown = Pressenzustand unbekannt
reason-readings-contradict-the-model = die Fühler der Platte widersprechen dem Modell
reason-run-begins-in-the-closed-press = die Aufzeichnung beginnt in der geschlossenen Presse
reason-run-begins-with-the-panel-on-the-hot-plate = die Aufzeichnung beginnt mit der Platte auf der heißen Heizplatte
reason-run-refused = der Pressung kann nicht gefolgt werden: { $problem }
reason-start-not-read = Kern nicht bestimmbar: der Anfang kommt aus den ersten Messwerten, und es gibt noch keinen
reason-start-temperature-contradicted = die Fühler zeigen { NUMBER($measured_C, maximumFractionDigits: 0) } °C, die Kopfdaten nennen { NUMBER($header_C, maximumFractionDigits: 0) } °C als Anfangstemperatur
reason-start-temperature-too-high = die Kopfdaten nennen { NUMBER($header_C, maximumFractionDigits: 0) } °C als Anfangstemperatur; so heiß ist keine frische Platte
reason-store-away = der Datenspeicher antwortet nicht
resin-is-example = das Harz „{ $name }“ ist ein Beispiel; das eigene Papier messen und dessen Kinetik in die Harzdatei eintragen
resin-needs-panel = die Presse hat keine Platte, also härtet kein Papier; das Harz weglassen
resin-no-limits = die Harzdatei hat keine Grenze in [limits], open_now bleibt 0; cure_least setzen
resin-no-moisture = { $key } fehlt im Kopf oder ist 0, der Dampf ist unbekannt und open_now bleibt 0; den Schlüssel ergänzen oder steam_most_kPa aus der Harzdatei nehmen
resin-not-verified = die Zahlen des Harzes „{ $name }“ sind nicht mit ihrer Quelle verglichen; vergleichen, dann verified = true in die Harzdatei eintragen
steam-limit-no-marks = { $runs ->
        [one] von der einen als good oder blister markierten Pressung ist der Dampf beim Öffnen nicht bekannt
       *[other] von keiner der { $runs } als good oder blister markierten Pressungen ist der Dampf beim Öffnen bekannt
    }; Platten markieren ({ $key }) und panel.moisture_percent angeben

## softsensor.jobs: services and nights

coefficient-has-changed = { $coefficient } hat sich seit Pressung { $run } geändert (bemerkt bei { $noticed }): jetzt { NUMBER($percent, maximumFractionDigits: 0) } % des früheren Werts; prüfen, was davor an der Presse gemacht wurde
dask-no-answer = Dask-Scheduler { $address }: keine Antwort in { $seconds } s; [refit] dask prüfen, und ob er läuft
dask-no-worker = Dask-Scheduler { $address }: kein Worker in { $seconds } s; dask worker { $address } starten
dask-package-missing = Dask-Scheduler { $address }: das Paket 'distributed' fehlt; auf einem Pressen-PC bringt es kerntemp_setup.py complete, sonst pip install 'kerntemp[dask]'
dask-scheduler-lost = Der Dask-Scheduler { $address } ging während der Arbeit verloren; prüfen, dass er läuft, dann neu beginnen
dask-workers-lost = Der Dask-Scheduler { $address } hat seit { SPAN($seconds) } keinen Worker mehr; dask worker { $address } starten
model-none-before = Presse { $press }: kein früheres Modell, zu dem man zurückkehren könnte
night-against-core-silenced = der Kern ist in weniger Messzeilen gültig
night-against-core-worse = der Kern wird schlechter
night-against-not-significant = der Gewinn ist nicht signifikant
night-against-predicts-worse = es sagt Pressungen schlechter vorher
night-against-still-helps = ein Effekt, der wegfiele, verbessert die Anpassung noch
night-archive = { $press }: { $archived ->
        [one] eine Pressung
       *[other] { $archived } Pressungen
    } ins Archiv verschoben ({ NUMBER($freed, minimumFractionDigits: 1, maximumFractionDigits: 1) } MB zu { NUMBER($written, minimumFractionDigits: 1, maximumFractionDigits: 1) } MB){ $removed ->
        [0] { "" }
       *[other] , Messzeilen von { $removed } gelöscht
    }{ $later ->
        [0] { "" }
       *[other] , { $later } folgen in den nächsten Nächten
    }
night-at-work-already = an Presse { $press } in { $store } arbeitet schon ein anderer nächtlicher Lauf: diesen zu Ende kommen lassen
night-compared =
    { $kind ->
        [with] { $effects }
        [without] nicht mehr: { $without }
       *[both] { $effects }; nicht mehr: { $without }
    }: Residuum einzelner Fühler{ $still ->
        [yes] { " in Ruhe" }
       *[no] { "" }
    }, eigene Kontakte angepasst, von { NUMBER($before, minimumFractionDigits: 3, maximumFractionDigits: 3) } auf { NUMBER($after, minimumFractionDigits: 3, maximumFractionDigits: 3) } K auf { $apart ->
        [yes] { $runs } unbeteiligten Pressungen
       *[no] { $runs } Pressungen der Diagnose
    }{ $predicted }{ $core }{ $against }
night-compared-against = { "; " }{ $what }
night-compared-core = { ", " }Kern von { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } auf { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K im Betrieb
night-compared-predicted = { ", " }Vorhersagen von { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } auf { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K daneben
night-diagnosis-confirms = die Diagnose bestätigt es
night-failed = { $press }: nächtlicher Lauf gescheitert: { $why }
night-first-model = erstes Modell, Koeffizienten aus { $runs } Pressungen
night-first-model-although = erstes Modell, Koeffizienten aus { $runs } Pressungen; { $although }
night-fits =
    { $fitted } von { $runs } Pressungen ausgewertet, { $kept ->
        [0] { "" }
        [one] bei 1 bleibt es,{ " " }
       *[other] bei { $kept } bleibt es,{ " " }
    }{ $failed } nicht auswertbar{ $blind ->
        [0] { "" }
       *[other] , { $blind } ohne Fühler an der Platte
    }
night-fits-later = { $fits }, { $later } ältere folgen in { $nights ->
        [one] der nächsten Nacht
       *[other] den nächsten { $nights } Nächten
    }
night-left-to-you = { $version } wird nicht von selbst in Kraft gesetzt; zu entscheiden ist von Hand: { $reason }
night-like-rolled-back = { $reason }; wie { $version }, das zurückgenommen wurde
night-not-sure-yet = nur ein Verdacht, da alle Nächte zusammen noch nicht beweisen, dass etwas fehlt: { $causes }
night-nothing-changed = nichts hat sich geändert
night-outcome =
    { $press }: { $fits }; Diagnose: { $verdict ->
        [not_asked] nicht gefragt
        [no_effect] kein Effekt
        [named] Ursache benannt
        [ambiguous] Ursache eingegrenzt
        [unknown_effect] unbekannter Effekt
        [too_few_runs] zu wenige Pressungen
        [not_described] das Modell beschreibt die Pressungen nicht
       *[other] siehe ihren Bericht
    }; { $model ->
        [promoted] Modell { $version } in Kraft gesetzt
        [stays] Modell { $version } bleibt
       *[none] noch kein Modell
    }: { $reason }
night-rejected = { $version } abgelehnt: { $reason }
night-too-few-runs = { $runs ->
        [one] eine Pressung
       *[other] { $runs } Pressungen
    } ausgewertet, { $needed } sind nötig
night-too-few-to-judge = zu wenige Pressungen für ein Urteil
night-without-sisters = { $press }: beginnt ohne das, was baugleiche Pressen gelernt haben: { $why }
night-workers-killed = { $press }: Die Prozesse, die an ihrer Nacht arbeiteten, wurden abgebrochen; der nächtliche Lauf arbeitet selbst daran, Pressung für Pressung
night-workers-lost = Die Prozesse gingen verloren: { $why }; an den übrigen Pressen arbeitet der nächtliche Lauf selbst
press-problem = { $press }: { $problem }
run-fit-again = Pressung { $run }: der Rechenprozess wurde abgebrochen oder reagierte nicht mehr, ein anderer wertet sie aus; vermutlich ist Arbeitsspeicher knapp
run-fit-killed = Pressung { $run } konnte nicht ausgewertet werden: der Rechenprozess wurde zweimal abgebrochen oder reagierte nicht mehr; vermutlich fehlt Arbeitsspeicher
run-not-fitted = Pressung { $run } konnte nicht ausgewertet werden: { $why }
run-not-judged = Pressung { $run } blieb beim nächtlichen Urteil außen vor: { $why }
run-nothing-to-fit = Pressung { $run } hat keine Fühler an der Platte: nichts auszuwerten
sense-compiling = übersetzt das Modell, einmal nach einer Installation oder Aktualisierung: etwa eine Minute
sense-following = folgt { $presses }
sense-follows-run = folgt Pressung { $run }
sense-model-not-taken = der Softsensor kann das geltende Modell nicht übernehmen und arbeitet mit { $version } weiter: { $why }
sense-resin-not-taken = die Harzdatei ist so nicht lesbar, Aushärtung, Dampf und Freigabe gehen nach dem, was vorher darin stand: { $why }
sense-takes-model = der Softsensor nimmt Modell { $version }
sense-waiting = wartet auf Messungen

## softsensor.report: figures

figure-adaptive = Löser mit angepassten Schritten
figure-advice-any = irgendeine Grenze, Heizplatten { NUMBER($platen, maximumFractionDigits: 0) } °C
figure-advice-others = irgendeine Grenze, bei { NUMBER($low, maximumFractionDigits: 0) } bis { NUMBER($high, maximumFractionDigits: 0) } °C
figure-advice-press-time = Presszeit [s]
figure-advice-risk = Risiko, eine Grenze zu verletzen [%]
figure-blister-chance = Wahrscheinlichkeit einer Blase [%]
figure-channels = alle Fühler
figure-coefficient = { $name } = { NUMBER($mean, maximumSignificantDigits: 4) } W/m²K
figure-coefficient-shared = { $name } = { NUMBER($mean, maximumSignificantDigits: 4) } W/m²K, gemeinsam
figure-coefficient-spread = { $name } = { NUMBER($mean, maximumSignificantDigits: 4) } ± { NUMBER($sd, maximumSignificantDigits: 2) } W/m²K
figure-coefficient-unknown = { $name } [W/m²K] ist nicht bekannt
figure-core = Kern, { $model }
figure-core-band = sein 95-%-Band
figure-core-by-fit = Kern nach dem angepassten Modell
figure-core-fitted = { $run }: Kern schlimmstenfalls auf ± { NUMBER($half, minimumFractionDigits: 1, maximumFractionDigits: 1) } K bekannt (95 %)
figure-core-fitted-measured = { $run }: Kern schlimmstenfalls auf ± { NUMBER($half, minimumFractionDigits: 1, maximumFractionDigits: 1) } K bekannt (95 %); Thermoelemente { NUMBER($error, minimumFractionDigits: 1, maximumFractionDigits: 1) } K (RMS) daneben
figure-core-live = Kern, wie live vorhergesagt, mit seinem 95-%-Band
figure-core-measured = Kern, gemessen
figure-correlation = Korrelation
figure-cost = Kosten je Messwert über ihrem Minimum
figure-dots-and-lines = Punkte: gemessen, Linien: simuliert
figure-exact = exakter Löser
figure-extended = erweitert
figure-fit = { $run }: das Modell liegt { NUMBER($fit, minimumFractionDigits: 2, maximumFractionDigits: 2) } K (RMS) neben den Fühlern ({ NUMBER($guesses, minimumFractionDigits: 1, maximumFractionDigits: 1) } K mit Schätzwerten)
figure-from-best = { $name }, Abweichung vom besten Wert [%]
figure-known-from-run = Bekannt aus { $run }: { $known }
figure-known-from-runs = { $runs } Pressungen: aus jeder bekannt { $known }; Streuung von Pressung zu Pressung bis { NUMBER($percent, maximumFractionDigits: 0) } %
figure-largest = { $sign }{ NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K bei { NUMBER($at, minimumFractionDigits: 1, maximumFractionDigits: 1) } s
figure-mean = gemessen (Mittel)
figure-measured = gemessen
figure-measured-mean = gemessen, Mittel aus { $channels } Fühlern ± ihre Streuung
figure-measured-minus-model = gemessen − Modell [K]
figure-misfit-saved = Abnahme [σ²]
figure-model = Modell, { $model }
figure-moves-with = { $run }: { $one } korreliert am stärksten mit { $other } ({ $sign }{ NUMBER($size, minimumFractionDigits: 2, maximumFractionDigits: 2) })
figure-normalised = Bezogen auf das Mittel: { $name } schwankt am meisten von Pressung zu Pressung ({ NUMBER($percent, maximumFractionDigits: 0) } %)
figure-not-described = { $run }: das Modell beschreibt diese Pressung nicht: { NUMBER($fit, minimumFractionDigits: 2, maximumFractionDigits: 2) } K (RMS) daneben ({ NUMBER($guesses, minimumFractionDigits: 1, maximumFractionDigits: 1) } K mit Schätzwerten)
figure-nothing-known = Kein Koeffizient ist bekannt: das Modell beschreibt das Gemessene nicht
figure-over-mean = Wert / Mittel
figure-plain = einfach
figure-plan-best = beste Einstellungen
figure-plan-repeated = übliche Einstellungen
figure-plan-with-core = ebenso mit Fühler im Kern
figure-rehearsal-nothing = nichts verborgen
figure-rehearsal-share = Anteil der Versuchsreihen [%]
figure-residuals = Was alle Pressungen gemeinsam haben, fehlt dem Modell
figure-roughness = Angepasste Schritte machen die Kosten rau: Differenzen messen die Schritte, nicht die Steigung
figure-run = Pressung
figure-since-beginning = Zeit seit Beginn [s]
figure-since-closing = Zeit seit dem Schließen [s]
figure-steam = Dampf beim Öffnen [kPa]
figure-temperature = Temperatur [°C]
figure-time = Zeit [s]
figure-votes = { $better } von { $runs } Pressungen, jede einmal ausgelassen, passen mit dieser Ursache besser: { $cause }
figure-with-fit = Modell mit angepassten Koeffizienten
figure-with-guesses = Modell mit den Schätzwerten der Pressendatei
figure-worst-run = { $run }, die am schlechtesten passende Pressung: das einfache Modell liegt { NUMBER($rms, minimumFractionDigits: 2, maximumFractionDigits: 2) } K daneben (RMS der Mittel je Stelle)
figure-worst-run-extended = { $run }: { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K daneben, erweitert { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K ({ $causes })
figure-worth = Wert einer Pressung [nat]
figure-worth-of-pressing = Was eine Pressung je offenem Punkt wert ist

## softsensor.report: nights

night-back = Zurück zur vorigen Version:
night-cannot-write = { $path }: der Bericht kann nicht geschrieben werden: { $why }; siehe [refit] reports
night-diagnosis = Diagnose
night-drift = { $coefficient }: { $what }
night-drifts = Drift
night-effects = Effekte
night-fitted-with = angepasst mit
night-in-force = Modell in Kraft
night-no-diagnosis = Noch keine.
night-no-drift = Kein Koeffizient zeigt eine Drift.
night-no-effects = keine
night-no-model = Es gibt noch kein Modell: { $reason }.
night-not-fitted = nicht angepasst
night-parameters = Parameter
night-promoted = Modell { $version } wurde in Kraft gesetzt: { $reason }.
night-residual = Residuum der Seiten
night-run-not-described = { $rmse }, vom Modell nicht beschrieben
night-runs = Neueste Pressungen
night-spread = eine Pressung kann abweichen um
night-started = Beginn
night-status = Stand
night-status-candidate = Kandidat
night-status-promoted = in Kraft gesetzt
night-status-rejected = abgelehnt
night-status-retired = abgelöst
night-stays = Modell { $version } bleibt in Kraft: { $reason }.
night-title = Nächtliche Anpassung der Presse „{ $press }“
night-unit = Einheit
night-verdict = Urteil:
night-version = Version
night-versions = Versionen
night-warnings = Warnungen im Journal
night-why = warum
night-with-guesses = mit den Schätzwerten der Pressendatei
night-with-press-file = Pressendatei

## softsensor.report: reports of fits and diagnoses

kelvin-off = { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K
kelvin-signed = { $sign }{ NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K
known-all = alle Koeffizienten
known-none = keiner der Koeffizienten
paper-adaptive = angepasste Schritte
paper-boundary-not-measured = { $boundary } ist { $kind }; der Löser der Arbeit nimmt nur gemessene Ränder: Pressungen einer Presse vergleichen, deren Ränder Spalten sind
paper-exact = exakt
paper-exact-sensitivities = exakt
paper-finite-differences = Differenzen
paper-no-measurement = keine Messung angegeben; mindestens eine angeben
paper-none-judged = judged = { $judged }: nichts davon wird hier angepasst ({ $known }); mindestens eines davon nennen
paper-slope-changes = Kosten entlang { $name } innerhalb ±{ NUMBER($span, maximumSignificantDigits: 1) } %: die Steigung wechselt mit angepassten Schritten { $adaptive }-mal das Vorzeichen, mit dem exakten Löser { $exact }-mal.
paper-truth-missing = der wahre Wert von { $names } fehlt; für jeden nicht festen Koeffizienten einen angeben
report-95-bootstrap = 95 % (Bootstrap)
report-95-of-mean = 95 % des Mittels (t)
report-95-of-runs = 95 % seiner Pressungen
report-at-core = Am Kern: { $core }
report-bold-better = W/m²K, ± das halbe 95-%-Intervall. Fett: gemeinsam viel besser bekannt als einzeln.
report-bold-excludes = Fett: das 95-%-Intervall schließt „keine Änderung“ aus.
report-candidates = Alle Kandidaten
report-cause = Ursache
report-causes-alike = Diese Pressungen können die Ursachen nicht unterscheiden. Was es könnte:
report-chance = Wahrscheinlichkeit, dass Zufall allein so viel ergäbe
report-change = Änderung des Koeffizienten
report-coefficient = Koeffizient
report-coefficients = { $runs ->
        [0] Koeffizienten
        [one] Koeffizienten
       *[other] Über alle Pressungen
    }
report-cost = Was es kostet
report-count-of = { $count } von { $total }
report-decimals =
    { $digits ->
        [0] { NUMBER($value, maximumFractionDigits: 0) }
        [1] { NUMBER($value, minimumFractionDigits: 1, maximumFractionDigits: 1) }
        [2] { NUMBER($value, minimumFractionDigits: 2, maximumFractionDigits: 2) }
        [3] { NUMBER($value, minimumFractionDigits: 3, maximumFractionDigits: 3) }
        [4] { NUMBER($value, minimumFractionDigits: 4, maximumFractionDigits: 4) }
        [5] { NUMBER($value, minimumFractionDigits: 5, maximumFractionDigits: 5) }
        [6] { NUMBER($value, minimumFractionDigits: 6, maximumFractionDigits: 6) }
       *[other] { NUMBER($value, maximumSignificantDigits: 4) }
    }
report-dependence = Abhängigkeit vom Pressprogramm
report-diagnosis-basis = Presse „{ $press }“, { $runs } { $runs ->
        [one] Pressung
       *[other] Pressungen
    }
report-diagnosis-of = { $verdict } – Presse { $press }
report-error-core = Abweichung des Kerns an Kernfühlern, Platten nach ihren Kopfdaten
report-error-core-predicted = Abweichung an Kernfühlern, Pressungen vorhergesagt
report-every-run = Jede Pressung für sich
report-every-run-joint = Jede Pressung mit dem, was sie von den anderen übernimmt
report-extended-model = erweitertes Modell
report-fit-of = Wärmeübergangskoeffizienten der Presse „{ $press }“
report-fitted = Angepasst an { $runs ->
        [one] eine Pressung
       *[other] { $runs } Pressungen
    } liegt das Modell { NUMBER($fit, minimumFractionDigits: 2, maximumFractionDigits: 2) } K neben den Fühlern ({ $runs ->
        [one] { "" }
       *[other] Median;{ " " }
    }{ NUMBER($guesses, minimumFractionDigits: 1, maximumFractionDigits: 1) } K mit den Schätzwerten der Pressendatei).
report-from-on = { $begin } s bis zum Ende
report-from-to = { $begin } s – { $end } s
report-gain = Was gewonnen ist
report-how = Wie das gefunden wurde
report-how-averages = Die Werte einzelner Pressungen stammen aus dem Verfahren des Aufsatzes, { $method } auf Mittelwerten der oberen und unteren Fühler; Zeitpunkte, Urteile und gemeinsame Schätzungen aus dem Verfahren von Kerntemp:
report-how-channels = Die Werte einzelner Pressungen stammen aus dem Verfahren des Aufsatzes, { $method } auf jedem Fühler mit eigenem Versatz; Zeitpunkte, Urteile und gemeinsame Schätzungen aus dem Verfahren von Kerntemp:
report-how-fitted = Levenberg–Marquardt im Logarithmus der Koeffizienten. Schließen, Öffnen und Schließrampe, Starttemperatur, Heizplatten- und Fühlerfehler werden in den Grenzen angepasst, in denen eine Messkette falsch sein kann, und verbreitern die Intervalle. Residuen gelten als zeitlich korreliert, ihre Größe wird aus jeder Pressung geschätzt. Ob ein Koeffizient bestimmbar ist, zeigt das Profil der Likelihood dieser Pressung.
report-how-model = Geschichtete Wärmeleitung mit einem Übergangskoeffizienten zwischen Nachbarn für jeden Pressenzustand, implizit gelöst mit exakten Ableitungen.
report-hundredths = { NUMBER($value, minimumFractionDigits: 2, maximumFractionDigits: 2) }
report-joint-median = gemeinsamer Median
report-known = { $runs ->
        [one] Aus ihr bekannt
       *[other] Aus diesen Pressungen bekannt
    }: { $known }.
report-known-to = { NUMBER($value, maximumSignificantDigits: 4) } ± { NUMBER($percent, maximumFractionDigits: 0) } %
report-legend-coefficients = Punkte: einzelne Pressungen mit 95-%-Intervallen. Linie und Band: Mittel und σ. Kreuz: eine Pressung, in der der Koeffizient nicht bestimmbar ist, gezeichnet beim Mittel derer, in denen er es ist; ist er es in keiner, ist nichts gezeichnet.
report-legend-core = Kern: die Mitte der Platte nach dem angepassten Modell. Sein Band ist, was Koeffizienten, Zeitpunkte, Messkette und die Konstanten der Platte offen lassen (95 %), soweit das Modell selbst stimmt. Kernthermoelemente nehmen an der Anpassung nicht teil.
report-legend-every-run = W/m²K, ± das halbe 95-%-Intervall. Kursiv: in dieser Pressung nicht bestimmbar; das Intervall, das die Daten offen lassen. Nicht beschrieben: das Modell passt nicht zur Pressung, aus ihr wird also nichts gelesen.
report-legend-measured = Fehlerbalken: Standardabweichung über die Fühler einer Seite. Grau gestrichelt: das Modell mit den Schätzwerten der Pressendatei. Getönt: Presse geschlossen. Residuen ohne den konstanten Versatz jeder Seite, ihr Band die Streuung der Fühler; wo sich die Presse bewegt, liegen sie außerhalb der Skala, und der größte Wert steht dabei.
report-legend-normalised = Punkte: einzelne Pressungen bezogen auf das Mittel, in ihrer Reihenfolge. Balken: ± σ.
report-legend-profile = Ein Profil zeigt, wie viel schlechter das Modell zur Pressung passt, je weiter ein Koeffizient verschoben wird, während alle anderen Unbekannten folgen; wo es unter der Linie bleibt, passt der Wert ebenso gut (95 %). Ein Profil, das die Linie auf einer Seite nicht schneidet, ist dort offen.
report-legend-run = Punkte: Mittel der Messwerte; getönt darum: vom niedrigsten bis zum höchsten Fühler. Grau: das einfache Modell mit den eigenen Koeffizienten dieser Pressung. Orange: mit der Ursache. Gestrichelt: Kern der Platte, wie der Kopf sie angibt. Getönt: Presse geschlossen; darunter, wo das einfache Modell am weitesten danebenliegt, und was dort gemessen wurde.
report-mean = Mittel
report-mean-note = Mittel und σ über die Pressungen, in denen der Koeffizient bestimmbar ist. Gemeinsamer Median und wahre Streuung: alle Pressungen zusammen geschätzt als Ziehungen aus einer lognormalen Gesamtheit, ohne den Fehler der einzelnen Schätzung.
report-measured-against-simulated = Gemessen gegen simuliert
report-measured-minus-plain = gemessen − einfaches Modell
report-measured-there = dort gemessen
report-method-least_squares = kleinste Quadrate mit Gradienten
report-method-nelder_mead = Nelder-Mead
report-method-nelder_mead_then_least_squares = Nelder-Mead und danach gewichtete kleinste Quadrate
report-misfit-saved = Abnahme der Abweichung, in Varianzen des Rauschens
report-next = Als Nächstes messen
report-no-cause = Keine Ursache des Katalogs wurde benannt.
report-no-core = kein Kernfühler
report-noise-alone = Rauschen der Fühler allein: { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K. Die Seiten können passen, während der Kern falsch ist: nur Kernfühler beweisen den Kern.
report-not-converged = nicht konvergiert
report-not-described = nicht beschrieben
report-not-known = { $runs ->
        [one] Nicht bekannt
       *[other] Nicht aus jeder Pressung
    }: { $names }.
report-not-varied = nicht verändert
report-notes = Hinweise
report-notes-on-runs = Hinweise zu einzelnen Pressungen
report-number = { NUMBER($value, maximumSignificantDigits: 4) }
report-number-2 = { NUMBER($value, maximumSignificantDigits: 2) }
report-number-3 = { NUMBER($value, maximumSignificantDigits: 3) }
report-paper = Warum kleinste Quadrate mit Gradienten stecken blieben, und warum das nicht sein muss
report-paper-converged = konvergiert
report-paper-error = Fehler gegen die Wahrheit
report-paper-note = Angepasste Schritte: LSODA mit den Voreinstellungen von scipy auf demselben Netz; seine exakten Ableitungen werden neben den Temperaturen vom selben Löser integriert. Konvergiert: die niedrigsten Kosten, die eines der vier fand, auf 2 %. Fehler: Median über die Messungen vom größten Fehler unter den Koeffizienten, die jede Pressung zeigt. Dass die Schwierigkeit des Aufsatzes diese Ursache hatte, ist eine Vermutung; dass diese Ursache dafür genügt, zeigt die Tabelle.
report-paper-slopes = Steigungen
report-paper-solver = Löser
report-paper-solves = Lösungen
report-paper-time = Zeit je Messung [s]
report-paper-what = Dieselben virtuellen Messungen, dieselben Startwerte (bis zum Faktor 3 daneben), derselbe Optimierer mit seinen Voreinstellungen; nur der Löser und die Art, Steigungen zu bekommen, unterscheiden sich.
report-per-10-degrees = je 10 °C Heizplattentemperatur
report-per-10-newton = je 10 N/cm² Druck
report-per-10-seconds = je 10 s Presszeit
report-percent = { NUMBER($percent, minimumFractionDigits: 1, maximumFractionDigits: 1) } %
report-place = Stelle
report-plain-model = einfaches Modell
report-plan = Was als Nächstes zu pressen ist
report-predicted = vorhergesagt
report-preferred = Gegenüber dieser Ursache ziehen die Pressungen sie um { NUMBER($t, maximumFractionDigits: 1) } Standardfehler vor: { $cause }.
report-prior = { $name }: { NUMBER($median, maximumSignificantDigits: 6) } W/m²K, mal oder durch { NUMBER($factor, maximumSignificantDigits: 6) }.
report-priors-note = Vorwissen aus der Pressendatei:
report-profile-of = Profil von { $name }
report-profiles = Profile und Korrelationen jeder Pressung
report-program = Ein nie gefahrenes Programm
report-program-of = Vorhergesagt für { $settings } (95 % der Pressungen)
report-residual-fitted = Residuum aller Fühler, angepasste Pressungen
report-residual-kelvin = Residuum [K]
report-residual-left-out = Residuum auf ausgelassenen Pressungen, eigene Kontakte angepasst, quadratisches Mittel aller Pressungen
report-residual-predicted = Residuum auf Pressungen, vorhergesagt nur aus Kopfdaten und den anderen Pressungen, quadratisches Mittel aller Pressungen
report-run = Pressung
report-run-not-described = { $runs ->
        [one] Die Pressung, die das Modell nicht beschreibt
       *[other] Die schlechteste der Pressungen, die das Modell nicht beschreibt
    }
report-runs = Pressungen
report-runs-that-know-it = Pressungen, die ihn kennen
report-saved-left-out = gespart auf einer typischen ausgelassenen Pressung
report-setting = { $name } = { $value } { $unit }
report-shared = gemeinsam
report-shared-note = In allen Pressungen war ein Wert verlangt: { $names }.
report-signed = { $sign }{ NUMBER($value, minimumFractionDigits: 2, maximumFractionDigits: 2) }
report-since-state-began = seit seinem Beginn
report-slope = { NUMBER($percent, minimumFractionDigits: 1, maximumFractionDigits: 1) } % ({ NUMBER($low, minimumFractionDigits: 1, maximumFractionDigits: 1) } … { NUMBER($high, minimumFractionDigits: 1, maximumFractionDigits: 1) })
report-span = { NUMBER($low, maximumSignificantDigits: 4) } – { NUMBER($high, maximumSignificantDigits: 4) }
report-span-3 = { NUMBER($low, maximumSignificantDigits: 3) } – { NUMBER($high, maximumSignificantDigits: 3) }
report-state = Zustand
report-symptom = Anzeichen: { $symptom }
report-tenths = { NUMBER($value, minimumFractionDigits: 1, maximumFractionDigits: 1) }
report-true-spread = wahre Streuung
report-typical-run = { $runs ->
        [one] Die Pressung
       *[other] Eine typische Pressung
    }
report-unknown = Was diese Pressungen nicht bestimmen können, und welche Messung es könnte
report-value = Wert
report-what-is-wrong = Was falsch ist
report-why = Warum
report-why-and-remedy = warum, und welche Messung hilft
report-with-guesses-kelvin = mit Schätzwerten [K]
report-worst-run = Die am schlechtesten passende Pressung
report-worth = erklärt { NUMBER($percent, maximumFractionDigits: 0) } % dessen, was die Pressungen gemeinsam haben, und { $worth }. Die Wahrscheinlichkeit, dass Zufall allein so viel ergäbe, aus dem Vertauschen der Vorzeichen ganzer Pressungen oder der Likelihood ausgelassener Pressungen: { $sureness }

## api: when to open

advice-blocked = { $limit ->
        [core_least] der Kern wird in der Vorhersagezeit nicht heiß genug
        [core_most] der Kern ist zu heiß
        [cure_bottom] die untere Fläche härtet in der Vorhersagezeit nicht aus
        [cure_top] die obere Fläche härtet in der Vorhersagezeit nicht aus
        [steam_most] zu viel Dampf, oder sein Druck ist nicht bekannt
       *[sudden_change] in der Presse hat sich etwas geändert: wie weit die Flächen gehärtet sind, ist nicht bekannt
    }
advice-estimate-old = Stand vor { SPAN($seconds) }
advice-no-look-ahead = der Softsensor hat noch keine Vorhersage
advice-no-panel = keine Platte in der Presse
advice-no-target = kein Kernziel gesetzt
advice-not-closed = Presse noch nicht geschlossen
advice-not-known = nicht bekannt: { $why }
advice-old = die letzte Vorhersage ist { SPAN($seconds) } alt
advice-open-in = öffnen in { NUMBER($seconds, maximumFractionDigits: 0) } s
advice-open-in-at-least = öffnen in { NUMBER($seconds, maximumFractionDigits: 0) } s ({ NUMBER($low, maximumFractionDigits: 0) } oder später)
advice-open-in-between = öffnen in { NUMBER($seconds, maximumFractionDigits: 0) } s ({ NUMBER($low, maximumFractionDigits: 0) } bis { NUMBER($high, maximumFractionDigits: 0) })
advice-open-in-or-later = öffnen in { NUMBER($seconds, maximumFractionDigits: 0) } s (oder später)
advice-open-now = JETZT ÖFFNEN
advice-opened = geöffnet
advice-opened-peak = geöffnet, der Höchstwert im Kern ist { NUMBER($peak_C, maximumFractionDigits: 0) } °C
advice-too-early = zu früh

## api: refusals of the server, access, health

alarm-body =
    { $what }
    Ausgelöst { $raised }, Alarm { $number }.
alarm-core-above = { $press }: der Kern ist über { NUMBER($limit, maximumFractionDigits: 1) } °C
alarm-drift = { $press }: { $coefficient } liegt seit { $since } bei { NUMBER($percent, maximumFractionDigits: 0) } % des Gewohnten
alarm-file = { $path }: nicht lesbar: { $why }
alarm-language = email.language = { $language } ist nicht vorhanden; es gibt { $known }
alarm-limits-crossed = die Grenze, unter der die Heizplatte zu kalt ist ({ NUMBER($below_C) } °C), muss unter der liegen, über der sie zu heiß ist ({ NUMBER($above_C) } °C)
alarm-missing = es gibt keinen Alarm { $number }
alarm-not-delivered = { $way }: Alarm { $number } wurde nicht angenommen, neuer Versuch folgt: { $why }
alarm-platen-above = { $press }: { $channel } ist über { NUMBER($limit, maximumFractionDigits: 1) } °C
alarm-platen-below = { $press }: { $channel } ist unter { NUMBER($limit, maximumFractionDigits: 1) } °C
alarm-silence = { $press }: seit mehr als { SPAN($limit) } kein Messwert
alarm-subject = Kerntemp: { $what }
alarm-thresholds-set = Alarmgrenzen von { $press } gesetzt: { $fields }
alarm-verdict = { $press }: die Diagnose lässt etwas unerklärt
alarm-webhook-address = { $path }: die erste Zeile ist keine http- oder https-Adresse
api-address-taken = { $host }:{ $port } ist nicht frei: { $why }; mit --port einen anderen Port wählen
api-body-late = die Anfrage kam nicht innerhalb von { $seconds } s an
api-body-not-json = die Anfrage muss JSON sein, mit Content-Type: application/json
api-body-number-too-long = eine Zahl mit { NUMBER($count) } Stellen bei '{ $key }': höchstens { NUMBER($digits) } werden gelesen; kürzen
api-body-too-deep = Objekte oder Listen mehr als { NUMBER($deepest) } tief ineinander bei '{ $key }'; flacher schreiben
api-body-too-large = die Anfrage darf höchstens { $bytes } Bytes haben
api-certificate-missing = { $path }: diese Datei gibt es nicht; Zertifikat und Schlüssel als PEM-Dateien angeben
api-certificate-needs-key = --certificate und --key gehören zusammen; beide angeben oder keins
api-certificate-unusable = { $certificate }, { $key }: { $why }; beide als PEM angeben, den Schlüssel ohne Passwort
api-change-needs-token = eine Änderung braucht ein Zugangstoken mit Schreibrecht; kerntemp token create legt eines an
api-columns-empty = columns = { $columns } nennt keine Spalte; columns für alle Spalten weglassen
api-field-invalid = { $field }: { $why }
api-field-name-invalid = { $field }: ein Name hat nur Buchstaben, Ziffern, _ und -, mit Punkten dazwischen
api-header-key-fixed = { $key } lässt sich so nicht ändern; siehe Bemerkung
api-header-key-twice = { $key } kann nicht zugleich ein Wert sein und Schlüssel enthalten
api-header-not-a-number = { $key } = { $value }: muss eine Zahl sein
api-instant-without-zone = { $instant } hat keine Zeitzone; Z oder einen Zeitversatz wie +01:00 anhängen
api-last-event-id-unknown = Last-Event-ID { $id } gehört nicht zu diesem Strom; weglassen
api-model-unknown = Modell { $version } gibt es nicht; /api/v1/models zählt sie auf
api-next-panel = nächste Platten von { $press }: { $recipe } { $fields }
api-no-curves = Diagnose { $number } hat keine Kurven: Es gibt keine mit dieser Nummer, oder sie stammt von einer Version vor dem 23.11.2026
api-no-night = es gibt keine Nacht { $number }
api-no-such-language = Sprache { $language } ist nicht vorhanden; es gibt { $languages }
api-nul-character = Pfad und Abfrage: ein NUL-Zeichen gehört nirgendwohin; weglassen
api-only-loopback-names = ohne Zugangstoken wird hier nur unter einem Namen dieses Rechners geantwortet
api-panel-marked = Pressung { $run }: Platte gekennzeichnet: { $verdict }
api-panel-unmarked = Pressung { $run }: Kennzeichnung der Platte zurückgenommen
api-press-unknown = Presse '{ $press }' gibt es nicht; es gibt: { $known }
api-query-unknown = query.{ $name }: unbekannt; bekannt sind hier: { $known }
api-query-unknown-of-none = query.{ $name }: unbekannt; hier ist keine bekannt
api-reading-needs-token = von anderswo zu lesen braucht ein Zugangstoken: Authorization: Bearer ...
api-request-invalid = { $problems }
api-run-changed = Pressung { $run }: { $fields } geändert
api-run-not-fitted = Pressung { $run } ist nicht angepasst; kerntemp refit holt es nach
api-run-not-simulated = Pressung { $run } lässt sich nicht simulieren: { $why }
api-run-unknown = Pressung { $run } gibt es nicht; /api/v1/runs zählt sie auf
api-run-without-press-file = Pressung { $run }: ihre Presse wurde ohne Pressendatei gespeichert
api-scans-span = von { $begin } bis { $end }: das Ende muss nach dem Anfang liegen, höchstens 25 h danach; ein anderes Ende wählen oder Tag für Tag fragen
api-search-bound = '{ $bound }' ist keine Grenze; zum Beispiel core_at_opening_C>=95 schreiben
api-search-order = '{ $order }' ist keine Reihenfolge; eines von { $known }, oder ein Schlüssel des Kopfes
api-search-unknown = keine Pressung hat die Zahl '{ $name }'; es gibt { $known }
api-server-failed = der Server ist an dieser Anfrage gescheitert; siehe sein Protokoll
api-slows-wrong-tokens = zu viele falsche Zugangstoken von { $address }; weitere werden langsam beantwortet
api-token-exists = das Zugangstoken { $name } gibt es schon; erst zurückziehen oder einen anderen Namen wählen
api-token-invalid = dieses Zugangstoken gilt nicht; kerntemp token create legt eines an
api-token-reads-only = Zugangstoken { $name } darf nur lesen; eine Änderung braucht das Schreibrecht
api-token-unknown = das Zugangstoken { $name } gibt es nicht; es gibt: { $known }
api-token-unknown-of-none = das Zugangstoken { $name } gibt es nicht; es gibt noch keines
api-tokens-entry = ein Eintrag besteht nicht aus fünf Texten: id, name, scope, sha256, created_utc
api-tokens-needed = server.host = { $host }: wer von anderswo liest, braucht ein Zugangstoken, und es gibt keines; eines anlegen mit kerntemp token create NAME --scope read oder auf 127.0.0.1 lauschen
api-tokens-no-file = keine Datei von Zugangstoken
api-tokens-no-scope = Zugangstoken { $name } hat keinen brauchbaren Umfang (scope) oder sha256
api-tokens-unreadable = { $path }: die Zugangstoken sind nicht lesbar: { $why }; die Datei entfernen und neue anlegen
api-too-many-listeners = zu viele Zuhörer; später wieder versuchen
api-too-many-wrong-tokens = zu viele falsche Zugangstoken von dieser Adresse; weitere falsche werden eine Minute lang verzögert beantwortet
health-archive-away = Archiv { $folder }: fehlt; seinen Datenträger einhängen oder das Archiv dorthin zurückkopieren, alte Pressungen sind bis dahin nicht lesbar
health-archive-unsound = Archiv { $folder }: { $files ->
        [one] eine Datei fehlt oder ist
       *[other] { $files } Dateien fehlen oder sind
    } beschädigt; das Journal nennt sie, aus einer Sicherung des Archivs zurückholen
health-disk-nearly-full = weniger als { $gigabytes } GB frei auf dem Datenträger des Datenspeichers
health-never-seen = noch nie gesehen
health-nightly-job-overdue = refit: der nächtliche Lauf ist seit { NUMBER($hours, maximumFractionDigits: 0) } h nicht zu Ende gekommen; siehe sein Protokoll
health-process-never-seen = { $process }: noch nie gesehen; kerntemp { $command } starten
health-process-silent = { $process }: seit { SPAN($seconds) } stumm; kerntemp { $command } starten
health-process-silent-for-hours = { $process }: seit { NUMBER($hours, maximumFractionDigits: 0) } h stumm; kerntemp { $command } starten
health-process-stopped = { $process }: wurde beendet; kerntemp { $command } starten
health-runs-damaged = { $runs ->
    [one] von den neuesten Pressungen ist eine
   *[other] von den neuesten Pressungen sind { $runs }
} im Datenspeicher { $store } beschädigt und nicht lesbar: { $names }; mit kerntemp backup --restore eine Sicherung daneben herstellen und sie dort holen
health-scans-behind = { $press }: { $scans } Messzeilen im Rückstand, dieser Rechner ist überlastet
what-if-busy = eine andere Was-wäre-wenn-Rechnung läuft; in einigen Sekunden wiederholen
what-if-no-model = { $run }: es gibt weder eine Anpassung dieser Pressung noch ein gültiges Modell

## api.commands: the command line

diagnosed-cause = { $name }: { $worth }; { $sureness }
diagnosed-causes = { $name } (nicht zu unterscheiden von { $others }): { $worth }; { $sureness }
diagnosed-next = Als Nächstes: { $sentence }
diagnosed-plan = Die nächsten Pressungen, die am meisten bringen (Einzelheiten: kerntemp plan):
diagnosed-residual = Residuum { NUMBER($base, minimumFractionDigits: 3, maximumFractionDigits: 3) } K, erweitertes Modell { NUMBER($extended, minimumFractionDigits: 3, maximumFractionDigits: 3) } K
terminal-backup-archive = die Messzeilen von { $runs ->
        [one] einer Pressung
       *[other] { $runs } Pressungen
    } sind im Archiv: auch den Ordner { $folder } kopieren
terminal-backup-contents = { $runs ->
        [one] eine Pressung
       *[other] { $runs } Pressungen
    }, { $scans ->
        [one] eine Messzeile
       *[other] { $scans } Messzeilen
    }, { $fits ->
        [one] eine Anpassung
       *[other] { $fits } Anpassungen
    }, { $models ->
        [one] ein Modell
       *[other] { $models } Modelle
    }
terminal-backup-one-only = --verify und --restore schließen einander aus; eins angeben: das Einspielen prüft die Kopie zuerst
terminal-backup-restored = { $file } eingespielt und verglichen: { $contents }
terminal-backup-sound = { $file } ist in Ordnung: { $contents }
terminal-backup-written = { $file } geschrieben und geprüft: { $contents }
terminal-calibrate-added = { $path }: { $entries ->
        [one] ein Eintrag
       *[other] { $entries } Einträge
    } vom { $day } ergänzt
terminal-calibrate-needs-mode = calibrate: entweder --room mit der Anzeige des Thermometers angeben oder --warm
terminal-calibrate-no-file = calibrate --write: kein Messgerät in { $config } hat eine Kalibrierdatei; einem den Namen einer Datei geben, etwa calibration = "{ $logger }.toml"
terminal-calibrate-not-kept = { $logger }: Versatz nicht aufgehoben; ihm den Namen einer Datei geben, calibration = "{ $logger }.toml"
terminal-calibrate-write-needs-room = calibrate: --write braucht --room
terminal-channel-verdict = { $channel } { $verdict }
terminal-channels-fail = { $bad } von { $all } Kanälen bestehen die Prüfung nicht: { $names }
terminal-check-buffer = Puffer { $file }: lässt sich schreiben, Platz für { NUMBER($hours, maximumFractionDigits: 1) } h Messzeilen
terminal-check-failed = { $path }: { $failures }
terminal-check-logger-failed = Presse { $press }, Messgerät { $logger }: { $why }
terminal-check-store-opens = Datenspeicher { $store }: lässt sich öffnen
terminal-check-well-formed = { $path }: wohlgeformt
terminal-coefficients-no-object = { $path }: muss ein Objekt {"{"}NAME: Wert{"}"} sein
terminal-coefficients-not-json = { $path }: kein JSON: { $why }
terminal-coefficients-or-model = --coefficients und --model schließen einander aus; eins angeben
terminal-coefficients-unreadable = { $path }: die Koeffizienten sind nicht lesbar: { $why }
terminal-completion-shell = --completion { $shell }: es gibt bash, zsh und fish
terminal-config-missing = { $path }: diese Konfiguration gibt es nicht; eine schreiben (siehe Runbook, Connect a logger) oder --config angeben
terminal-config-no-permission = { $path }: keine Leseberechtigung; sudo vor den Befehl setzen oder ein anderes --config angeben
terminal-demo-folder-taken = --data { $folder }: enthält schon einen Datenspeicher; einen neuen Ordner angeben oder ihn entfernen
terminal-export-needs-out = export braucht --out: eine Datei für eine Pressung, einen Ordner für mehrere
terminal-file-among-figures = { $path }: liegt unter den Bildern von --svg { $folder }; einen anderen Ort oder eine andere Endung angeben
terminal-fit-from = anfangs
terminal-fit-joint-median = gemeinsamer Median
terminal-fit-legend = W/m²K; ? steht hinter einem Koeffizienten, den die Pressung nicht bestimmt, beim Mittelwert hinter einem, den keine bestimmt. Was die Pressendatei festlegt, ist nicht aufgeführt.
terminal-fit-legend-campaign = Mittel und Streuung: über die Pressungen, die den Koeffizienten bestimmen. Gemeinsamer Median: alle Pressungen zusammen, mit 95-%-Intervall.
terminal-fit-mean = Mittel
terminal-fit-needs-runs = fit braucht Laufdateien und --press DATEI (oder nur --reproduce-paper)
terminal-fit-remark-of = { $count } von { $total } Pressungen, etwa { $run }: { $remark }
terminal-fit-remarks-kept = Was zu jeder einzelnen Pressung zu bemerken ist, steht in den Dateien von --json und --html.
terminal-fit-run = Pressung
terminal-fit-sd = Streuung
terminal-fit-shared = Ein Wert in allen Pressungen, mit einem Intervall: { $names }.
terminal-folder-for-several = { $path }: mehrere Pressungen brauchen einen Ordner; einen nennen, der in einem vorhandenen Ordner liegt
terminal-folder-is-a-file = --svg { $folder }: ist eine Datei; einen Ordner angeben
terminal-folder-name-empty = der Name des Ordners ist leer; einen angeben, oder . für den jetzigen
terminal-guide-folder = { $folder }: ist schon da und nicht leer; einen neuen Ordner nennen
terminal-guide-written = Leitfaden, Beispiele und Referenz: { $page } öffnen
terminal-hide-unknown = --hide: { $why }
terminal-hold-one-now = Jetzt einen Fühler zwischen zwei Fingern halten.
terminal-import-run-twice = zwei der Dateien enthalten die Pressung „{ $run }“; einer einen eigenen Schlüssel '# run = ...' geben
terminal-imported = { $runs ->
    [one] { $runs } Pressung gespeichert
   *[other] { $runs } Pressungen gespeichert
}
terminal-interrupted = abgebrochen
terminal-language-unknown = KERNTEMP_LANGUAGE = { $language }: diese Sprache ist nicht vorhanden; es gibt { $languages }
terminal-list-alone = --press, --material, --from und --to wählen, was aufgelistet wird; zu exportierende Pressungen werden genannt
terminal-list-created = angelegt
terminal-list-damaged = beschädigt
terminal-list-material = Material
terminal-list-material-unknown = --material = '{ $material }': keine Pressung hat es; es gibt { $known }
terminal-list-name = Name
terminal-list-press = Presse
terminal-list-run = Pressung
terminal-list-scope = Recht
terminal-list-started = Beginn
terminal-list-status = Stand
terminal-list-token = Zugang
terminal-model-in-force-again = { $press }: Modell { $version } gilt wieder
terminal-needs-package = kerntemp publish braucht { $package }: kerntemp[plant] installieren
terminal-no-channel-rose = kein Kanal stieg eindeutig ({ $rises }); eine Messstelle länger halten, und nur diese
terminal-no-store-here = kein Datenspeicher: weder { $config } noch { $store } ist hier; --store oder --config angeben
terminal-not-noted = { $what }; nicht im Journal vermerkt: { $why }
terminal-output-is-input = { $path }: wird von diesem Befehl gelesen und würde überschrieben; einen anderen Namen angeben
terminal-output-no-folder = { $path }: den Ordner { $folder } gibt es nicht; erst anlegen
terminal-output-not-a-file = { $path }: ist ein Ordner; einen Dateinamen angeben
terminal-output-twice = { $path }: ist für zwei Ausgaben angegeben; jeder einen eigenen Namen geben
terminal-output-unwritable = { $path }: kann nicht geschrieben werden: { $why }
terminal-press-enter = Nach etwa zehn Sekunden Enter drücken
terminal-probe-answers = { $place }: Modbus antwortet von den Stationen { $stations }
terminal-probe-answers-none = { $place }: keine Station antwortet auf Modbus
terminal-probe-for-configuration = für kerntemp.toml; die Kanäle benennen
terminal-probe-nothing-known = { $place }: kein bekanntes Messgerät misst hier Raumtemperatur; Strom, Kabel, Adresse und Baudrate prüfen
terminal-probe-reading = { $meaning }: { $percent } % auf Raumtemperatur: { $values }
terminal-probe-reads-as-well = passt ebenso gut: { $profiles }; auf das Typenschild sehen
terminal-probe-registers = Station { $station }, Funktion { $function }: Register ab 0, gelesen als
terminal-program-key-twice = --program { $setting }: { $key } ist zweimal angegeben; ein Programm hat einen Wert davon
terminal-program-no-number = --program { $setting }: „{ $value }“ ist keine Zahl
terminal-program-not-known =
    { $runs ->
        [one] --program: eine Pressung kann nicht zeigen, was { $settings } bewirkt; mindestens 8 Pressungen angeben, die sich darin unterscheiden (6, wenn sich nur eine Einstellung ändert)
       *[other] --program: { $runs } Pressungen können nicht zeigen, was { $settings } bewirkt; mindestens 8 Pressungen angeben, die sich darin unterscheiden (6, wenn sich nur eine Einstellung ändert)
    }
terminal-program-out-of-range = --program { $setting }: muss zwischen 0 und { $most } { $unit } liegen
terminal-program-unknown-key = --program { $setting }: muss KEY=WERT sein, mit KEY eins von { $known }
terminal-progress-advising = Programme werden durchgerechnet
terminal-progress-blisters = { $runs ->
        [one] Eine Pressung
       *[other] { $runs } Pressungen
    } nachspielen
terminal-progress-copying = { $store } wird kopiert
terminal-progress-diagnosing = { $runs ->
    [one] Diagnose von { $runs } Pressung
   *[other] Diagnose von { $runs } Pressungen
}
terminal-progress-exporting = { $runs ->
    [one] { $runs } Pressung wird gelesen
   *[other] { $runs } Pressungen werden gelesen
}
terminal-progress-fitting = { $runs ->
    [one] { $runs } Pressung wird angepasst
   *[other] { $runs } Pressungen werden angepasst
}
terminal-progress-guide = Schreibt die Seiten
terminal-progress-planning = { $runs ->
    [one] Planung nach { $runs } Pressung
   *[other] Planung nach { $runs } Pressungen
}
terminal-progress-predicting = Vorhersage von { $run }
terminal-progress-reading = { $files ->
    [one] { $files } Datei wird gelesen
   *[other] { $files } Dateien werden gelesen
}
terminal-progress-reading-runs = { $runs ->
    [one] { $runs } Pressung wird gelesen
   *[other] { $runs } Pressungen werden gelesen
}
terminal-progress-refitting = { $presses ->
    [one] Eine Presse wird
   *[other] { $presses } Pressen werden
} neu angepasst
terminal-progress-rehearsing = Diagnose von { $campaigns } simulierten Versuchsreihen
terminal-progress-reproducing = { $runs } virtuelle Messungen, jede auf vier Weisen
terminal-progress-restoring = { $file } wird eingespielt
terminal-progress-simulating = Simulation von { $run }
terminal-progress-storing = { $runs ->
    [one] { $runs } Pressung wird gespeichert
   *[other] { $runs } Pressungen werden gespeichert
}
terminal-progress-writing = Dateien werden geschrieben
terminal-refit-failed = { $failures }; das Journal nennt sie
terminal-refit-report = { $press }: Bericht { $page }
terminal-refit-unfit = { $press }: { $failed } von { $runs } Pressungen konnten nicht angepasst werden
terminal-reproduce-alone = --reproduce-paper macht seine eigenen Messungen und nimmt { $surplus } nicht an; es geht mit --json, --html und --svg
terminal-rise = { $logger }: größter { NUMBER($rise, minimumFractionDigits: 1, maximumFractionDigits: 1) } K, nächster { NUMBER($next, minimumFractionDigits: 1, maximumFractionDigits: 1) } K
terminal-room-check = { $channel } { NUMBER($mean, minimumFractionDigits: 2, maximumFractionDigits: 2) } °C, { $deviation } daneben, Rauschen { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K: { $verdict }
terminal-room-no-value = { $channel } { $verdict } ({ $quality })
terminal-rose = { $channel } ({ $logger }) stieg um { NUMBER($rise, minimumFractionDigits: 1, maximumFractionDigits: 1) } K
terminal-run-file-ending = { $path }: eine Laufdatei endet auf .csv oder .parquet, Ereignisdokumente auf .jsonl
terminal-run-neither-file-nor-stored = { $run }: diese Datei gibt es nicht, und keinen Datenspeicher zum Nachsehen; eine Datei, --store oder --config angeben
terminal-serves = kerntemp ist erreichbar unter { $address }
terminal-stations-no-numbers = --stations '{ $text }': Zahlen und Bereiche angeben, etwa 1-4,9
terminal-stations-out-of-range = --stations '{ $text }': Adressen liegen zwischen 0 und 255
terminal-token-needs-name = kerntemp token { $action }: braucht einen Namen
terminal-unexpected = { $kind }: { $why } (KERNTEMP_TRACEBACK=1 zeigt, wo)
terminal-until-leaves-too-little = { $run }: { $option } { $until } lässt { $rows } von { $all } Zeilen; die erste ist bei time_s = { $first }: einen späteren Zeitpunkt angeben
terminal-until-no-column = { $run }: { $option } nennt Spalte '{ $column }'; die Pressung hat { $known }
terminal-until-no-run = { $option } { $until }: keine Pressung '{ $run }' ist angegeben; Pressungen sind { $known }
terminal-until-not-reached = { $option } { $until } kommt in { $runs } nicht vor: dort wird nichts weggelassen; Sekunden angeben oder eine Temperatur, die erreicht wird
terminal-until-not-read = { $option } { $until }: Sekunden (900), eine Temperatur einer Spalte (bottom_1=140) oder eines von { $events } angeben, mit PRESSUNG: davor für eine Pressung allein
terminal-written = geschrieben: { $path }
terminal-written-several = geschrieben: { $files } Dateien in { $folder }
token-created = Zugangstoken { $name } angelegt, { $scope ->
    [write] darf ändern
   *[read] darf lesen
}
token-revoked = Zugangstoken { $name } zurückgezogen

## api.commands: help, and calls that are wrong

call-command-missing = kein Befehl angegeben; kerntemp --help nennt alle
call-command-unknown = { $command }: diesen Befehl gibt es nicht; kerntemp --help nennt alle
call-command-unknown-meant = { $command }: diesen Befehl gibt es nicht; gemeint ist wohl { $meant }
call-not-one-of = muss eins von { $known } sein
call-option-unknown = { $option }: diese Option gibt es nicht; --help nennt alle
call-option-unknown-meant = { $option }: diese Option gibt es nicht; ähnlich sind { $meant }
call-option-without-value = { $option }: braucht einen Wert
call-surplus = zu viel in diesem Aufruf: { $words }; Text mit Leerzeichen in Anführungszeichen setzen
help-advice-range = Was sich einstellen lässt, und wie weit: platen_temperature_C, press_time_s oder pressure_N_cm2. Mehrfach möglich; ohne Angabe { $platen_from } bis { $platen_to } °C, { $time_from } bis { $time_to } s und { $pressure_from } bis { $pressure_to } N/cm².
help-advice-resin = Die Harzdatei: Kinetik, Sorption und Grenzen beim Öffnen.
help-advice-svg = Die Presszeit gegen das Risiko in diese Datei zeichnen.
help-arguments = Argumente:
help-averages = Mit einem Verfahren des Aufsatzes: Mittel der oberen und der unteren Fühler statt jedes Fühlers.
help-backup-file = Die Kopie: eine neue SQLite-Datei.
help-baud = Baudrate der seriellen Leitung; ohne Angabe { $baud }.
help-calibrate-write = Die gefundenen Abweichungen in die Kalibrierdatei jedes Messgeräts schreiben.
help-certificate = TLS-Zertifikatskette, PEM.
help-coefficients = Koeffizienten, ein flaches {"{"}NAME: Wert{"}"}.
help-command-advise = Presszeit und Heizplattentemperatur für eine noch nicht gepresste Platte berechnen, so dass alle Grenzen mit gewünschter Wahrscheinlichkeit gelten.
help-command-backup = Den Datenspeicher kopieren, während andere in ihn schreiben. Die Kopie wird geprüft, bevor sie ihren Namen bekommt.
help-command-blisters = Aus Platten, die als gut oder mit Blase markiert sind, lernen, wie viel Dampf sie aushalten, für die Grenze in der Harzdatei.
help-command-calibrate = Alle Kanäle bei Raumtemperatur prüfen (--room) oder vertauschte finden (--warm). Vorher kerntemp record anhalten.
help-command-check = Konfiguration und Datenspeicher prüfen und jedes Messgerät einmal lesen.
help-command-demo = Alles an einer virtuellen Presse: Aufzeichnung, Live-Vorhersage, Anpassungen und Seite.
help-command-diagnose = Finden, was die Simulation falsch macht, warum, was es kostet und was als Nächstes zu messen ist.
help-command-export = Pressungen des Datenspeichers als Laufdateien schreiben oder auflisten.
help-command-fit = Die Wärmeübergangskoeffizienten jeder Pressung und der Versuchsreihe anpassen.
help-command-guide = Leitfaden, Beispiele und Referenz als Seiten in einen Ordner schreiben, lesbar ohne Server.
help-command-import = Laufdateien in den Datenspeicher aufnehmen: alle, oder keine, wenn eine falsch ist.
help-command-kerntemp = Kerntemperatur gepresster Platten: aufzeichnen, live vorhersagen, anpassen und finden, was das Modell falsch macht.
help-command-plan = Finden, welche Pressungen als Nächstes am meisten wert sind und was jede klären würde.
help-command-predict = Eine Pressung Messzeile für Messzeile durch den Softsensor schicken; keine Zeile nutzt spätere Messungen.
help-command-probe = Herausfinden, welches Messgerät an einer Leitung hängt; die Fühler haben dabei Raumtemperatur. Kein Gerät zur Hand? python -m daq.simulated.devices_serve adam-4118 legt ein simuliertes an eine Leitung.
help-command-publish = Einen MQTT-Broker beliefern ([mqtt]) und einen OPC-UA-Server betreiben ([opcua]), ohne Ende.
help-command-record = Alle Pressen der Konfiguration aufzeichnen, ohne Ende.
help-command-refit = Der nächtliche Lauf: alle Pressungen neu anpassen, Diagnose stellen und ein besseres Modell in Kraft setzen.
help-command-sense = Den Kern an allen Pressen der Konfiguration live vorhersagen, ohne Ende.
help-command-serve = Seite und REST-Schnittstelle anbieten; anderen Rechnern nur mit Zugangstoken.
help-command-simulate = Eine Pressung allein aus ihren Heizplattentemperaturen simulieren.
help-command-token = Zugangstoken anlegen, auflisten und zurückziehen. Ein neues wird einmal gezeigt.
help-commands = Befehle:
help-completion = Ausgeben, was eine Shell Befehle und Optionen mit der Tabulatortaste ergänzen lässt (bash, zsh, fish).
help-config = Die Konfiguration; ohne Angabe kerntemp.toml in diesem Ordner.
help-core-least = Temperatur, die der Kern beim Öffnen haben muss.
help-core-most = Temperatur, die der Kern beim Öffnen haben darf.
help-dask = Ein Dask-Scheduler, dessen Worker die Pressen übernehmen, bei einer einzigen deren Anpassungen; siehe [refit] dask.
help-data = Alles in diesem Ordner aufheben.
help-default = { $text } [ohne Angabe: { $value }]
help-device-host = Adresse eines Geräts im Netz.
help-environment = { $text } [oder die Umgebungsvariable { $name }]
help-export-format = Format der Dateien in einem Ordner; jsonl enthält Dokumente des Event-Modells von bluesky.
help-export-out = Eine Datei für eine Pressung, ein Ordner für mehrere.
help-export-runs = Namen von Pressungen; ohne Angabe werden alle aufgelistet.
help-goal = Wonach zu suchen ist: time, energy oder throughput.
help-guide-folder = Ein neuer Ordner; seine index.html ist die erste Seite.
help-help = Diese Seite zeigen.
help-hide = Diesen Effekt nur in der virtuellen Presse einschalten.
help-host = Adresse, auf der gelauscht wird; ohne Angabe die der Konfiguration.
help-html = Einen Bericht zum Lesen hierhin schreiben.
help-import-files = Laufdateien oder, mit --mapping, die eigenen Dateien eines anderen Messgeräts.
help-json = Alles als JSON hierhin schreiben.
help-key = Der private Schlüssel des Zertifikats, PEM.
help-law = Was fehlt, als freie Funktion von Zeit, Temperatur oder Tiefe schätzen, auch wo eine Ursache genannt ist; bei unknown_effect geschieht es ohnehin.
help-licences = Auflisten, was mitgeliefert oder mitinstalliert ist, mit Lizenz.
help-list-from = Nur Pressungen auflisten, die an diesem Tag oder später begannen, etwa 2026-03-04.
help-list-material = Nur Platten aus diesem Material auflisten.
help-list-press = Nur Pressungen dieser Presse auflisten.
help-list-to = Nur Pressungen auflisten, die vor diesem Tag begannen.
help-mapping = Eine Zuordnung, die die Dateien eines anderen Messgeräts erklärt, TOML.
help-method = default oder eins der Verfahren des Aufsatzes: least_squares, nelder_mead, nelder_mead_then_least_squares.
help-model = Eine Modelldatei, wie fit und diagnose sie schreiben.
help-model-out = Die Modelldatei der Versuchsreihe hierhin schreiben.
help-offline = Die Messgeräte nicht lesen.
help-open = Wie lange die Presse zwischen zwei Platten offen steht, für Energie und Durchsatz.
help-options = Optionen:
help-out = Die Tabelle hierhin schreiben.
help-page-port = Port der Seite; 0 nimmt einen freien.
help-panel = Ein Schlüssel aus dem Kopf einer Laufdatei, der Platte oder Raum beschreibt, etwa panel.thickness_mm=16. Mehrfach möglich; ohne Angabe { $material } von { $millimetres } mm.
help-period = Zeit zwischen zwei Messungen.
help-port = Port; 0 nimmt einen freien und zeigt ihn.
help-press = Die Pressendatei.
help-pressings = Nach so vielen Pressungen anhalten; ohne Angabe bei Strg-C.
help-price = Preis einer kWh in Euro.
help-probability = Wahrscheinlichkeit, mit der alle Grenzen gelten sollen; ohne Angabe die der Harzdatei oder { $probability }.
help-program = Ein noch nie gefahrenes Pressprogramm, durch seine Einstellungen: seine Koeffizienten werden aus denen der Versuchsreihe vorhergesagt. Mehrfach möglich.
help-range = Was sich einstellen lässt, und wie weit: platen_temperature_C, press_time_s, thickness_mm, start_temperature_C, waiting_s oder pressure_N_cm2. Mehrfach möglich; ohne Angabe der Bereich der Pressungen selbst, maßvoll erweitert.
help-rehearse = Solche Versuchsreihen mit dem eigenen Modell des Softsensors simulieren, mit jeder Ursache der Reihe nach und ohne, sie diagnostizieren und berichten, wie oft eine Ursache gefunden und wie oft eine falsche genannt wird.
help-rehearse-campaigns = Simulierte Versuchsreihen je Ursache; ohne Angabe { $campaigns }.
help-rehearse-dask = Ein Dask-Scheduler, dessen Worker die simulierten Versuchsreihen übernehmen.
help-rehearse-effect = Nur diese Ursache verbergen, in eigener Größe, wenn eine angegeben ist. Mehrfach möglich; ohne Angabe alle, die diese Pressungen zeigen könnten.
help-rehearse-file = Jede fertige simulierte Versuchsreihe in dieser Datei festhalten und nach einem Abbruch von dort weitermachen.
help-reproduce-paper = Stattdessen: warum die Gradientenverfahren stecken blieben, gezeigt an { $measurements } virtuellen Messungen. --json, --html und --svg heben die Tabelle und die Kosten entlang eines Koeffizienten auf.
help-resin = Wie das Papier härtet und was beim Öffnen gelten muss (TOML): ergänzt Härtung, Dampf und open_now.
help-restore = Einen neuen, leeren Datenspeicher aus der Kopie füllen.
help-roll-back = Nur zum vorigen Modell dieser Presse zurückgehen.
help-room = Raumtemperatur von einem Thermometer neben den Fühlern, { $least } bis { $most } °C.
help-run = Eine Laufdatei oder der Name einer Pressung im Datenspeicher.
help-runs = Laufdateien oder Namen von Pressungen im Datenspeicher.
help-scope = write schließt read ein.
help-seed = Eine andere Zahl ist eine andere Presse.
help-serial-port = Serieller Anschluss: /dev/ttyUSB0, COM5 oder socket://host:port.
help-shared = Ein Koeffizient mit einem Wert in allen Pressungen. Mehrfach möglich.
help-speed = Vielfaches der wirklichen Geschwindigkeit, { $least } bis { $most }.
help-stations = Adressen, die versucht werden, etwa 1-4,9.
help-store = Der Datenspeicher: ein Pfad oder eine URL postgresql://.
help-svg = Alle Bilder als SVG in diesen Ordner schreiben.
help-tcp-port = TCP-Port des Geräts; ohne Angabe { $port }.
help-timeout = Wartezeit auf eine Antwort, { $least } bis { $most }; ohne Angabe { $seconds }.
help-token-action = Was zu tun ist.
help-token-name = Für wen das Zugangstoken ist.
help-transport = Wie Modbus gesprochen wird; ohne Angabe entscheidet der Ort.
help-until = Die Zeilen jeder Pressung nach diesem Punkt weglassen: einem Zeitpunkt von time_s, einer Temperatur, die eine Spalte erreicht (bottom_1=140), oder inserted, closed, opened, removed. PRESSUNG:... gilt für eine Pressung allein. Mehrfach möglich; das früheste zählt.
help-usage = Aufruf: { $call }
help-verify = Nur eine vorhandene Kopie prüfen.
help-version = Die Version zeigen.
help-wait = Zeit zum Erwärmen mit der Hand; ohne Angabe beendet Enter das Warten.
help-waiting = Vom Einlegen der Platte bis zum Schließen.
help-warm = Den Fühler finden, der mit der Hand erwärmt wird.
help-without = Spalten, die verborgen werden, durch Kommas getrennt; Muster wie top_* sind erlaubt.
help-word-address = ADRESSE
help-word-args = ANGABEN
help-word-celsius = CELSIUS
help-word-column = SPALTE
help-word-columns = SPALTEN
help-word-command = BEFEHL
help-word-day = TAG
help-word-dir = ORDNER
help-word-effect = EFFEKT
help-word-event = EREIGNIS
help-word-file = DATEI
help-word-folder = ORDNER
help-word-high = OBEN
help-word-key = SCHLÜSSEL
help-word-list = LISTE
help-word-low = UNTEN
help-word-name = NAME
help-word-options = OPTIONEN
help-word-out = ZIEL
help-word-port = PORT
help-word-press = PRESSE
help-word-run = PRESSUNG
help-word-seconds = SEKUNDEN
help-word-shell = SHELL
help-word-size = GRÖSSE
help-word-value = WERT
help-workers = Prozesse auf diesem Rechner; siehe [refit] workers.

## api.plant: feeds

plant-address-taken = { $host }:{ $port } ist nicht frei: { $why }; opcua.port setzen
plant-broker-not-connected = der MQTT-Broker { $where } hat die Verbindung nicht angenommen: { $why }; es wird weiter versucht
plant-broker-not-subscribed = der MQTT-Broker { $where } hat nicht zurückgeschickt, was er aufhebt: { $why }; es wird weiter versucht
plant-broker-not-taking = der MQTT-Broker { $where } hat eine Nachricht nicht angenommen: { $why }; es wird weiter versucht
plant-broker-refused = abgelehnt: { $reason }
plant-broker-silent = keine Antwort
plant-broker-unreachable = MQTT-Broker { $where }: { $why }; prüfen, ob er läuft und erreichbar ist
plant-certificate-missing = { $path }: diese Datei gibt es nicht; Zertifikat und Schlüssel als DER- oder PEM-Dateien angeben
plant-certificate-needed = opcua.host = { $host }: für Zugriffe von anderswo ist ein Zertifikat nötig; eins mit seinem Schlüssel angeben
plant-certificate-needs-key = opcua.certificate und opcua.key gehören zusammen; beide angeben oder keins
plant-client-fault = OPC-UA-Client { $address }: { $why }{ $left_out ->
    [0] {""}
   *[other] ; { NUMBER($left_out) } weitere dieser Art seit der letzten Zeile
}
plant-feeds-broker = beliefert den MQTT-Broker { $where }
plant-messages-sent = { $messages ->
    [one] { $messages } Nachricht gesendet
   *[other] { $messages } Nachrichten gesendet
}
plant-no-sign-of-life = ein Lebenszeichen lässt sich gerade nicht schreiben: { $why }
plant-node-core = Vorhergesagte Kerntemperatur
plant-node-core-high = Oberes Ende des 95-%-Bands der Kerntemperatur
plant-node-core-low = Unteres Ende des 95-%-Bands der Kerntemperatur
plant-node-core-sd = Standardabweichung der Kerntemperatur
plant-node-event = Das letzte Ereignis: inserted (eingelegt), closed (geschlossen), opened (geöffnet) oder removed (entnommen)
plant-node-model = Modellversion, aus der die Schätzung stammt
plant-node-open-now = Ob die Presse jetzt öffnen darf: jede Grenze der Harzdatei gilt; falsch, wo etwas nicht bekannt ist
plant-node-pressure = Druck { $channel }
plant-node-reason = Warum es keine Schätzung gibt; leer, solange es eine gibt
plant-node-run = Die Pressung, die aufgezeichnet wird; leer zwischen zweien
plant-node-state = idle (keine Platte), open (offen), closed (geschlossen) oder unknown (unbekannt)
plant-node-thermocouple = Thermoelement { $channel }
plant-node-wire = Schaltdraht { $channel }, 1 heißt geschlossen
plant-nothing-configured = { $path }: weder [mqtt] noch [opcua]; ergänzen, was das Werk liest
plant-password-unreadable = { $path }: das Passwort des Brokers ist nicht lesbar: { $why }
plant-retained-foreign = Presse { $press }: der Broker hält eine Nachricht { $kind } mit der Nummer { $number }, die nicht aus diesem Datenspeicher ist; gesendet wird alles nach der letzten Nachricht, die sicher angekommen ist
plant-server-fault = OPC-UA-Server: { $why }{ $left_out ->
    [0] {""}
   *[other] ; { NUMBER($left_out) } weitere dieser Art seit der letzten Zeile
}
plant-tokens-needed = opcua.host = { $host }: wer von anderswo liest, braucht ein Zugangstoken als Passwort, und es gibt keines; eines anlegen mit kerntemp token create NAME --scope read

## api.demo: the demonstration

demo-begins = Eine virtuelle Presse mit { NUMBER($speed) }-facher Geschwindigkeit, { $pressings ->
    [one] { $pressings } Pressung
   *[other] { $pressings } Pressungen
}.
demo-begins-without-end = Eine virtuelle Presse mit { NUMBER($speed) }-facher Geschwindigkeit, bis Strg-C.
demo-column-band = im Band
demo-column-band-unit = von 95 %
demo-column-closing = Schließen
demo-column-core = Kernfehler
demo-column-core-unit = live, RMS
demo-column-found = gefunden-wahr
demo-column-opening = Öffnen
demo-column-run = Pressung
demo-column-scans = Messzeilen
demo-column-surface = Residuum in Ruhe
demo-column-surface-unit = vor, nach Anpassung
demo-column-worst = größter
demo-compiling = Erster Start: das Übersetzen des Modells dauert etwa eine Minute ...
demo-core-off = Kern { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K daneben
demo-core-unknown = Kern nicht bekannt
demo-diagnosis-there = Diagnose: { $diagnosis }; was die Nacht getan hat: { $night }
demo-did-not-start = { $process } ist nicht gestartet: { $why }
demo-ended = { $process } endete mit Status { $status }: { $why }
demo-gain = Kernfehler der letzten { $runs } Pressungen: { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K wie live ausgegeben, { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K mit dem in Kraft gesetzten Modell
demo-heldout = Pressungen, reihum ausgelassen, eigene Kontakte angepasst: { $plain } K daneben mit dem einfachen Modell, { $extended } K mit dem erweiterten
demo-hidden = In der virtuellen Presse versteckt: { $effects }
demo-kept = Aufbewahrt in { $folder }; wieder ansehen mit: kerntemp serve --config { $config }
demo-logger = { $profile } an { $place }
demo-loggers = Messgeräte     { $places }
demo-named = Nächtlicher Lauf: Urteil „{ $verdict }“, { $causes }
demo-named-none = Nächtlicher Lauf: Urteil „{ $verdict }“, keine Ursache benannt
demo-next = Nächste Messung: { $what }
demo-night = Nächtlicher Lauf: alle Pressungen werden neu angepasst, und gesucht wird, was das Modell falsch macht ...
demo-night-awaited = Darauf wird gewartet; Strg-C beendet die Demonstration ohne sein Ergebnis.
demo-night-comes = Nach { $pressings ->
        [one] einer Pressung
       *[other] { $pressings } Pressungen
    }, in etwa { $minutes } min, sucht der nächtliche Lauf, was das Modell falsch macht; die Seite bleibt bis Strg-C.
demo-night-left = Der nächtliche Lauf war im Gange und endet mit der Demonstration.
demo-no-diagnosis = Der nächtliche Lauf hat keine Diagnose geschrieben.
demo-no-message = keine Meldung
demo-no-pressing = zu lange wurde keine Pressung aufgezeichnet; die Protokolle liegen neben dem Datenspeicher
demo-no-sign-of-life = { $seconds } s lang kein Lebenszeichen von { $processes }
demo-not-fitted = { $runs ->
    [one] { $runs } Pressung wurde nicht rechtzeitig angepasst
   *[other] { $runs } Pressungen wurden nicht rechtzeitig angepasst
}
demo-not-found = { $runs ->
    [one] { $runs } Pressung wurde nicht gefunden
   *[other] { $runs } Pressungen wurden nicht gefunden
}
demo-not-kept = Nichts davon wird aufbewahrt; --data DIR bewahrt alles auf.
demo-not-promoted = Modell { $version } wurde nicht in Kraft gesetzt: { $why }
demo-page = Seite          { $address }
demo-pressing = Pressung { $run }: { $scans } Messzeilen, Schließen { NUMBER($closing, minimumFractionDigits: 2, maximumFractionDigits: 2) } s und Öffnen { NUMBER($opening, minimumFractionDigits: 2, maximumFractionDigits: 2) } s daneben, Residuum in Ruhe von { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } auf { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, { $core }
demo-scans-left-out = { $left_out } von { $all } Messzeilen wurden ausgelassen
demo-store = Datenspeicher  { $path }
demo-stored = Mit der virtuellen Presse verglichen: { $runs } Pressungen, { $scans } Messzeilen
demo-summary = Zusammenfassung von { $runs ->
    [one] { $runs } Pressung
   *[other] { $runs } Pressungen
} an der virtuellen Presse
demo-token = Um auf der Seite etwas zu ändern, ein Token erzeugen und dort unter Zugang eingeben: kerntemp token create operator --scope write --config { $config }
demo-too-slow = Dieser Rechner hielt mit { NUMBER($speed) }-facher Geschwindigkeit nicht Schritt: { $troubles }; ein kleineres --speed angeben
demo-view = { "               " }{ $address }  { $name }

## deploy: the installer

setup-building = das Wheel von { $folder } wird gebaut
setup-command-failed = { $name } ist gescheitert: { $why }
setup-compiling = das Modell wird übersetzt; das dauert einmal etwa eine Minute
setup-complete = Kerntemp { $version } hat alles, was { $file } verlangt: { $extras }.
setup-config-unreadable = { $file }: { $error }; erst in Ordnung bringen
setup-installed = Kerntemp { $version } ist installiert.
setup-installing = Version { $version } wird in { $folder } installiert
setup-kept-newer = was Version { $version } aufgezeichnet hat, liegt weiter in { $file }
setup-needs-root = braucht root; sudo verwenden
setup-needs-venv = { $why }; apt-get install python3-venv
setup-needs-wheel = diese Datei liegt nicht in den Quellen von Kerntemp; ein Wheel angeben
setup-next = Als Nächstes { $file } bearbeiten, dann: kerntemp check && systemctl start kerntemp.target
setup-no-wheel = { $file }: kein Wheel; die Datei kerntemp-VERSION-py3-none-any.whl angeben
setup-nothing-before = es gibt keine Version, auf die man zurückgehen könnte
setup-other-version = das installierte Programm nennt als Version '{ $found }', erwartet war { $version }
setup-other-wheel = { $file }: enthält { $name }, nicht kerntemp
setup-removed = Kerntemp ist entfernt. Konfiguration und Daten liegen weiter in { $settings } und { $data }.
setup-restore-postgresql = PostgreSQL: die Kopie kommt in die neue, leere Datenbank von store.url
setup-rollback-partly = Version { $version } ist wieder in Kraft, aber nicht alles davon läuft
setup-rolled-back = Kerntemp { $version } ist wieder in Kraft.
setup-schema-changes = Schema des Speichers { $before } wird { $after }: die Aufzeichnung hält für die Sicherung an
setup-store-still-newer = der Speicher ist noch der von Version { $version }: { $why }
setup-there-already = Version { $version } ist schon installiert; { $folder }
setup-update-partly = Version { $version } ist in Kraft, aber nicht alles läuft; rollback geht zurück auf { $old }
setup-updated = Kerntemp { $version } ist in Kraft; python3 kerntemp_setup.py rollback geht zurück auf { $old }.
setup-use-install = nichts ist installiert; install verwenden
setup-use-update = Version { $version } ist installiert; update verwenden
setup-version-gone = Version { $version } ist nicht mehr in { $folder }; ihr Wheel mit update installieren

## page: the press now

page-at-opening = Beim Öffnen
page-band-from = Das Band kommt von
page-band-from-constants = den Stoffwerten der Platte
page-band-from-contacts = den Kontakten
page-band-from-discrepancy = dem, was dem Modell fehlt
page-band-from-effects = den Effekten im Modell
page-band-from-panel = der Dicke, die diese Presse noch nicht hatte
page-band-from-start = den Temperaturen von Start und Heizplatten
page-band-from-suspected = vermuteten Ursachen
page-band-from-timing = den Zeitpunkten der Presse
page-chart-now-label = Temperaturen der Pressung über der Zeit, mit vorhergesagtem Kern und 95-%-Band
page-core-behind = Der Softsensor hat die letzten { $time } der Messwerte nicht ausgewertet: die Kurve des Kerns endet davor.
page-core-foreseen = Kern, Vorhersage bei geschlossener Presse
page-cure = Aushärtung, weniger gehärtete Seite
page-curves-missing = Die Kurven dieser Pressung lassen sich nicht laden: { $why }
page-energy = Aufgenommene Wärme
page-faces-and-platens = Plattenflächen und Heizplatten
page-grade-glossy = glänzend
page-grade-matt = matt
page-grade-undercured = nicht ausgehärtet
page-last-pressing = Letzte Pressung
page-left-out-channel = zuletzt { $kelvin } K { $side ->
    [below] unter
   *[above] über
 } den Nachbarn, nicht verwendet
page-limit-in = Grenze in
page-no-estimate = Noch keine Vorhersage
page-no-press = Noch keine Presse
page-no-press-hint = Eine Presse erscheint hier, sobald ihre Aufzeichnung beginnt: 'kerntemp record' mit einer Konfiguration; die von 'kerntemp demo' innerhalb einer halben Minute nach deren Start.
page-open-then = öffnen
page-press = Presse
page-running-pressing = Laufende Pressung
page-sensor-starting = der Softsensor startet; beim ersten Mal dauert das etwa eine Minute
page-stale-since = Keine neue Messung seit { $time }
page-steam = Dampf
page-time-since-closing = Seit dem Schließen
page-waiting-for-pressing = Warten auf die erste Pressung
page-wall = Wandansicht

## page: the wall

page-full-screen = Vollbild
page-health-core-unknown = alles läuft, Kern nicht bekannt
page-health-degraded = eingeschränkt
page-health-ok = alles gut
page-health-runs = alles läuft

## page: the next panel

page-moisture = Feuchte
page-next-faces = Die Flächen jetzt: oben { $top }, unten { $bottom }
page-next-hint = Gilt für jede Pressung bis zur Änderung, die Starttemperatur nur für eine.
page-next-kept = Gespeichert: die nächste Pressung beginnt damit.
page-next-panel = Nächste Platte
page-panel-verdict = Was wurde aus Platte { $run }?
page-recipe-name = Als Rezept merken
page-recipe-none = ohne Rezept
page-start-temperature = Starttemperatur

## page: alarms

page-alarm-core = Kern über
page-alarm-drift = Drift ab
page-alarm-drift-hint = Drift meldet die Regelkarte eines Koeffizienten, sobald genug Pressungen angepasst sind; kleinere Änderungen als diese bleiben dabei aus.
page-alarm-here = In diesem Browser
page-alarm-limits = Grenzen von { $press }
page-alarm-limits-hint = Leer: keine Grenze. Benachrichtigung über E-Mail oder Webhook: [email] und [webhook] in kerntemp.toml.
page-alarm-limits-kept = Grenzen gespeichert.
page-alarm-new = Kerntemp: Alarm
page-alarm-no-leave = Der Browser erlaubt hier keine Benachrichtigungen.
page-alarm-no-number = { $name }: eine Zahl ist nötig
page-alarm-notification = Bei neuem Alarm benachrichtigen
page-alarm-over = vorbei { $time }
page-alarm-platen-above = Heizplatte über
page-alarm-platen-below = Heizplatte unter
page-alarm-silence = Kein Messwert seit
page-alarm-sound = Bei neuem Alarm einen Ton geben
page-alarm-sound-waits = Der Ton ist eingeschaltet; der Browser spielt ihn erst nach einem Klick oder einer Taste auf dieser Seite.
page-alarm-stands = steht an
page-alarm-take = Quittieren
page-alarm-take-this = Quittieren: { $what }
page-alarm-taken = Quittiert
page-alarm-verdict = Wenn die Diagnose etwas unerklärt lässt
page-no-alarms = Noch kein Alarm.

## page: runs

page-all = alle
page-all-channels = alle übrigen Kanäle
page-and-more = und { $count } weitere
page-band-at-opening = Band beim Öffnen
page-blisters = Dampf, den Platten von { $press } aushalten
page-blisters-chance = Wahrscheinlichkeit einer Blase
page-blisters-marked = Markierte Platten
page-blisters-none = Noch keine Platte ist als gut oder mit Blase markiert.
page-cancel = Abbrechen
page-change = Ändern
page-changes = Änderungen
page-compare = Vergleichen
page-compare-loose = Schließen nicht bekannt, von der ersten Messzeile an gezeichnet: { $runs }
page-compare-without = Nicht bekannt für { $runs }
page-converged = konvergiert
page-core-at-opening = Kern beim Öffnen
page-core-peak = Kern, höchster Wert
page-differences = Einstellungen und Ergebnisse
page-dots-measured = Punkte: gemessen, Mittel der Fühler
page-empty-removes = Ein leerer Wert entfernt die Zeile. Wer was ändert, wird festgehalten.
page-fit = Anpassung
page-fit-left = RMSE { $before } K mit den Startwerten → { $after } K
page-fit-left-still = während weder Presse noch Platte bewegt wird { $before } K mit den Startwerten → { $after } K
page-from = Von
page-further-off = weiter weg als die Startwerte
page-isotherm = weiß: { $temperature } °C
page-left-out = Fehlende oder simulierte Messwerte
page-measured = gemessen
page-measured-and-core = Gemessen, und der Kern wie live vorhergesagt
page-measured-simulated = Gemessen gegen simuliert
page-metadata = Metadaten
page-new-key = Neuer Name
page-no-fit = Noch nicht angepasst.
page-no-runs = Keine Pressungen gefunden.
page-no-runs-lacking = Noch keine Pressung hat { $names }.
page-no-simulation = Keine Simulation zu dieser Pressung.
page-not-converged = nicht konvergiert
page-not-described = vom Modell nicht beschrieben
page-number-ambient-temperature_C = Umgebungstemperatur [°C]
page-number-band_at_opening_K = Band beim Öffnen [K]
page-number-core_at_opening_C = Kern beim Öffnen [°C]
page-number-core_peak_C = Kern, höchster Wert [°C]
page-number-panel-conductivity_W_mK = Wärmeleitfähigkeit der Platte [W/mK]
page-number-panel-density_kg_m3 = Dichte der Platte [kg/m³]
page-number-panel-heat_capacity_J_kgK = Wärmekapazität der Platte [J/kgK]
page-number-panel-initial_temperature_C = Starttemperatur [°C]
page-number-panel-material = Material
page-number-panel-moisture_percent = Feuchte [%]
page-number-panel-thickness_mm = Dicke [mm]
page-number-panel-verdict = Platte wurde
page-number-press_time_s = Gepresst [s]
page-number-recipe = Rezept
page-number-rmse_K = RMSE der Anpassung [K]
page-number-setting-core_target_C = Kernziel [°C]
page-number-setting-platen_temperature_C = Heizplattentemperatur, eingestellt [°C]
page-number-setting-press_time_s = Presszeit, eingestellt [s]
page-number-setting-pressure_N_cm2 = Druck, eingestellt [N/cm²]
page-pressed = Gepresst
page-profile = Temperatur durch die Platte
page-profile-axes = Zeit nach rechts, Unterseite unten, Oberseite oben
page-profile-label = Bild der Temperatur über Dicke und Zeit
page-quantity = Größe
page-reference = Minus
page-remark = Bemerkung
page-residual = Residuum: gemessen minus simuliert
page-rmse = RMSE der Anpassung
page-rmse-hint = RMSE wie bei der Anpassung: jeder gute Kanal ohne seine konstante Abweichung, über die ganze Pressung.
page-scans = Messzeilen
page-scatter = Eine Zahl über der anderen
page-scatter-newest = Von den neuesten { $count } der gefundenen Pressungen; eine engere Suche findet andere.
page-scatter-of = Zeigt { $shown } von { $count ->
        [one] einer Pressung
       *[other] { $count } Pressungen
    }{ $lacking ->
        [0] { "." }
        [one] { "; bei einer fehlt eine der beiden Zahlen." }
       *[other] ; bei { $lacking } fehlt eine der beiden Zahlen.
    }
page-scatter-right = nach rechts
page-scatter-up = nach oben
page-search = Suche
page-search-bounds = Werte
page-simulated = simuliert
page-simulating = Diese Pressung wird simuliert …
page-state-closed = geschlossen
page-state-open = offen
page-to = Bis
page-what-if = Was wäre, wenn
page-what-if-as-it-was = Wie es war, simuliert
page-what-if-ask = Simulieren
page-what-if-asked = Mit diesen Einstellungen
page-what-if-hint = Dieselbe Platte zwischen Heizplatten, die der Presse folgen wie zuvor, in einem Band aus allem, was nicht bekannt ist.
page-what-if-moisture_percent = Feuchte [%]
page-what-if-platen_temperature_C = Heizplatten [°C]
page-what-if-press_time_s = Presszeit [s]
page-what-if-pressure_N_cm2 = Druck [N/cm²]
page-what-if-start_temperature_C = Starttemperatur [°C]
page-what-if-thickness_mm = Dicke [mm]
page-what-if-waiting_s = Warten vor dem Schließen [s]

## page: the journal

journal-note = Notiz: { $text }
journal-press-closed = Die Presse schließt
journal-press-inserted = Eine Platte wird eingelegt
journal-press-opened = Die Presse öffnet
journal-press-removed = Die Platte wird entnommen
page-journal-empty = Nichts dieser Art.
page-level = Stufe
page-level-alarm = Alarm
page-level-info = Hinweis
page-level-warning = Warnung
page-note = Notiz zu { $press }
page-note-keep = Notieren
page-note-kept = Die Notiz ist aufbewahrt
page-press-events = Pressen
page-repeated = { $count }-mal in { $time }

## page: loggers

page-archive = Archiv
page-archive-holds = { $runs ->
        [one] eine Pressung
       *[other] { $runs } Pressungen
    }, { $size }{ $unsound ->
        [0] { "" }
       [one] ; eine Datei fehlt oder ist beschädigt
       *[other] ; { $unsound } Dateien fehlen oder sind beschädigt
    }
page-channel = Kanal
page-clock = Uhr
page-clock-here = Gegen die Uhr dieses Bildschirms
page-clock-never = nicht seit Beginn
page-clock-set = Zuletzt gestellt
page-crc-errors = CRC-Fehler
page-free = Frei auf dem Datenträger
page-gaps = Lücken, letzte Stunde
page-health-down = ausgefallen
page-hours-left = Reicht für
page-kind = Art
page-last-good = Zuletzt gut
page-last-sign = Letztes Lebenszeichen
page-logger = Messgerät
page-newest-scan = Neueste Messzeile
page-no-channels = Noch kein Kanal.
page-other-faults = Andere Fehler
page-process = Prozess
page-process-done = fertig
page-process-running = läuft
page-process-starting = startet
page-process-stopped = beendet
page-processes = Prozesse
page-readings = Messungen
page-reconnects = Neuverbindungen
page-silent = stumm
page-size = Größe
page-store = Datenspeicher
page-timeouts = Zeitüberschreitungen

## page: coefficients

page-against = Über
page-c-h_ap = Presse – Luft
page-c-h_p_c = Heizplatte – Blech, geschlossen
page-c-h_p_o = Heizplatte – Blech, offen
page-c-h_pp_c = Blech – Platte, geschlossen
page-c-h_pp_o = Blech – Platte, offen
page-c-h_wa = Platte – Luft
page-ci-high = oben
page-ci-low = unten
page-coefficients-hint = Wärmeübergangskoeffizienten, nach jeder Pressung neu angepasst, mit 95-%-Intervallen. Graue Punkte: aus dieser Pressung nicht bestimmbar.
page-coefficients-sisters = Bis eigene Pressungen sie besser bestimmen, sind die Koeffizienten dieser Presse { $why }.
page-drift = Drift
page-drift-creep = kriecht um { $change } seit { $run }
page-drift-hint = Eine Regelkarte fragt nach jeder Pressung, ob die Werte eines Koeffizienten noch so unter den früheren liegen, als hätte sich nichts geändert.
page-drift-jump = Sprung um { $change } bei { $run }
page-drift-none = keine zu sehen
page-history = Verlauf
page-identifiable = bestimmbar
page-last-fit = Letzte Anpassung
page-no-fits = Noch keine angepasste Pressung.
page-not-identifiable = nicht bestimmbar
page-order-of-runs = Reihenfolge der Pressungen

## page: diagnosis

page-all-sensors = alle Fühler
page-cause = Ursache
page-core = Kern
page-curves = Gemessen und simuliert: { $run }
page-curves-hint = Die Pressung, die das einfache Modell am schlechtesten trifft. Punkte: Mittel der Fühler. Darunter: gemessen minus Modell.
page-curves-residual = { $place }: gemessen minus Modell
page-earlier = Frühere Diagnosen
page-effects = Effekte
page-evidence = Belege: Gewinn auf einer typischen ungesehenen Pressung, je Ursache
page-evidence-other = Der längste Balken, { $cause }, ist nicht die genannte Ursache: ein Balken zeigt, was eine Ursache allein spart; gewählt wird danach, wie einheitlich die Pressungen eine Ursache vorziehen.
page-explains = erklärt { NUMBER($percent, maximumFractionDigits: 0) } % dessen, was die Pressungen gemeinsam haben
page-gain-left-out = weniger Fehler in ausgelassenen Pressungen, eigene Kontakte angepasst
page-gain-predicted = weniger Fehler in vorhergesagten Pressungen
page-heldout = ausgelassen, eigene Kontakte angepasst, quadratisches Mittel aller Pressungen
page-heldout-gain = Gewinn auf ausgelassenen Pressungen
page-luck = Wahrscheinlichkeit, dass Zufall allein so viel ergäbe
page-measured-there = Dort gemessen
page-model-rejected = abgelehnt
page-models = Modellversionen
page-next-measurement = Nächste Messung
page-no-diagnosis = Noch keine Diagnose.
page-no-diagnosis-hint = Der nächtliche Lauf 'kerntemp refit' schreibt eine, sobald genug Pressungen vorliegen.
page-no-gain = Keine Ursache senkt den Fehler auf ungesehenen Pressungen.
page-no-models = Noch keine Modellversion.
page-noise-floor = Rauschgrenze
page-nowhere = Nirgends über dem Rauschen.
page-nowhere-sought = Nicht gesucht: Über diese Pressungen gibt es kein Urteil.
page-off-by = Abweichung
page-or = oder
page-parameter = Parameter
page-place = Stelle
page-plain-extended = einfach → erweitert
page-plain-model = einfaches Modell
page-predicted = vorhergesagt, quadratisches Mittel aller Pressungen
page-promote = In Kraft setzen
page-promote-question = Modellversion { $version } für die Live-Vorhersage in Kraft setzen?
page-reason = Grund
page-roll-back = Hierauf zurück
page-sentence-no_effect = Das einfache Modell erklärt diese Pressungen bis auf das Rauschen.
page-sentence-not_described = Das Modell liegt zu weit von diesen Pressungen weg, für ein Urteil.
page-sentence-too_few_runs = Zu wenige Pressungen für eine Diagnose.
page-sentence-unknown_effect = Etwas bleibt unerklärt, das der Katalog nicht kennt.
page-since-it-began = Seit Beginn
page-suspected-causes = Verdacht, nicht bewiesen
page-version = Version
page-where = Wo das einfache Modell falsch liegt

## page: nights

page-night = Nacht
page-night-archive = { $archived } archiviert, { $freed } frei{ $removed ->
        [0] { "" }
       *[other] ; Messzeilen von { $removed } gelöscht
    }{ $later ->
        [0] { "" }
       *[other] ; { $later } folgen
    }
page-night-blind = { $runs } ohne Fühler an der Platte
page-night-fitted = Ausgewertet
page-night-later = { $runs } ältere folgen in { $nights ->
        [one] der nächsten Nacht
       *[other] den nächsten { $nights } Nächten
    }
page-night-left-out = Ausgelassen
page-night-memory = Speicher
page-night-model = Modell
page-night-named = Benannt
page-night-new = Neu
page-night-none = noch kein Modell
page-night-not-asked = nicht gefragt: dieselben Pressungen wie in der Nacht davor
page-night-not-fitted = { $runs } nicht auswertbar
page-night-promoted = { $version } in Kraft gesetzt
page-night-refused = { $version } abgelehnt
page-night-report = Bericht dieser Nacht
page-night-standing = { $runs } schon ausgewertet
page-night-stays = { $version } bleibt
page-night-stored = { $runs } gespeichert
page-night-took = Dauer
page-night-why = Warum ({ $runs })
page-nights-hint = Was der nächtliche Lauf 'kerntemp refit' für jede Presse getan hat.
page-no-nights = Noch keine Nacht: der nächtliche Lauf 'kerntemp refit' ist noch nicht gelaufen.

## page: access

page-access-hint = Lesen auf diesem Rechner braucht kein Zugangstoken, von anderswo und für jede Änderung schon: 'kerntemp token create'.
page-token = Zugangstoken
page-token-gone = Entfernt.
page-token-kept = Bleibt bis zum Schließen des Tabs.
page-use-token = Für diesen Tab verwenden

## page: everywhere

page-access = Zugang
page-ago = vor { $time }
page-alarms-more = { $count ->
        [one] 1 weiterer Alarm
       *[other] { $count } weitere Alarme
    }
page-answer-not-known = nicht bekannt
page-api-docs = API
page-back = Zurück
page-band95 = 95-%-Band
page-channels = Kanäle
page-chart-as-of = Stand { $time }
page-chart-data = Zahlen und Dateien
page-chart-every = gezeigt ist jede { $step }. Zeile, die Datei hat alle
page-chart-high = obere Grenze
page-chart-keys = Pfeiltasten lesen Werte, mit Umschalt verschieben sie den Ausschnitt; + und − vergrößern, 0 zeigt wieder alles
page-chart-low = untere Grenze
page-chart-newer = Neuere zeigen
page-chart-wheel = Zum Vergrößern Strg halten und das Mausrad drehen
page-chart-whole = Alles zeigen
page-choose-press = Presse
page-core-predicted = Kern, vorhergesagt
page-core-simulated = Kern, simuliert
page-core-temperature = Kerntemperatur
page-could-not-load = Diese Ansicht konnte nicht geladen werden.
page-date-unknown = unbekannt
page-day = Tag
page-day-after = Der Tag danach
page-day-before = Der Tag davor
page-day-hint = Jeder Punkt ist der höchste oder tiefste Wert aller Fühler in seinem Zeitschritt; ein vergrößerter Ausschnitt wird feiner gelesen. Linien gehen durch Lücken bis 10 min.
page-day-of = Ein Tag der Presse { $press }
page-day-view = Ganze Tage
page-day-whole = Ganzer Tag
page-field-no-number = { $key }: { $value } ist keine Zahl
page-field-outside = { $key } = { $value }: muss eine Zahl von { NUMBER($lower) } bis { NUMBER($upper) } { $unit } sein
page-files-only = keine Aufzeichnung, nur Dateien
page-follow = Folgen
page-guide = Leitfaden und Referenz
page-highest = höchster
page-in-use = in Gebrauch
page-interval = 95-%-Intervall
page-language = Sprache
page-last-identifiable = zuletzt bestimmbar, { $run }
page-link-live = live
page-link-lost = keine Verbindung
page-link-waiting = verbindet …
page-loading = wird geladen …
page-lowest = tiefster
page-material = Material
page-more = Mehr
page-name = Name
page-nav-access = Zugang
page-nav-alarms = Alarme
page-nav-coefficients = Koeffizienten
page-nav-diagnosis = Was die Simulation falsch macht
page-nav-journal = Journal
page-nav-loggers = Messgeräte
page-nav-nights = Nächte
page-nav-now = Presse jetzt
page-nav-presses = Alle Pressen
page-nav-runs = Pressungen
page-nav-wall = Wandansicht
page-need-token = Zugangstoken eingeben
page-needs-javascript = Diese Seite zeigt, was die API liefert, und braucht JavaScript.
page-next-by = von { $who }, { $time }
page-no-answer = Der Server antwortet nicht.
page-no-reading-for = seit { $time } keine Messung
page-no-reading-yet = noch keine Messung
page-no-readings = keine Messwerte
page-no-sign-of-life = Kein Lebenszeichen von { $process }; läuft es nicht, kerntemp { $command } starten
page-panel-blister = Blase
page-panel-good = gut
page-panel-scrap = Ausschuss
page-panel-undercured = nicht ausgehärtet
page-peak-then = der Höchstwert im Kern ist dann { NUMBER($peak, maximumFractionDigits: 0) } °C
page-platens = Heizplatten
page-quality = Güte
page-quality-bad_frame = Telegramm fehlerhaft
page-quality-good = gut
page-quality-late = zu spät
page-quality-missing = fehlt
page-quality-open = Drahtbruch
page-quality-over = über Bereich
page-quality-simulated = simuliert
page-quality-stale = veraltet
page-quality-under = unter Bereich
page-run = Pressung
page-run-closed = vollständig
page-run-damaged = beschädigt
page-run-interrupted = unterbrochen
page-run-open = läuft
page-save = Speichern
page-sensor-stray = nicht verwendet, folgt seiner Seite nicht
page-sensors-bottom = Platte unten
page-sensors-top = Platte oben
page-skip = Zum Inhalt
page-sort-by = Sortieren nach
page-started = Zeit
page-state = Zustand
page-state-idle = leer
page-state-unknown = unbekannt
page-status = Status
page-suspected = Vermutete Ursache
page-suspected-another-panel = eine andere Platte, als die Kopfdaten sagen
page-suspected-sudden-change = eine plötzliche Änderung an Presse oder Fühler
page-target = Ziel
page-target-not-deciding = Grenzen des Harzes, nicht { NUMBER($target, maximumFractionDigits: 0) } °C
page-target-value = { NUMBER($target, maximumFractionDigits: 0) } °C
page-theme = Hell oder dunkel
page-thickness = Dicke
page-time-axis = Zeit [s]
page-time-from-closing = Zeit ab dem Schließen [s]
page-unanswered = Der Server antwortet nicht.
page-value = Wert
page-verdict = Urteil
page-views = Ansichten
page-what = Was
page-when = Wann
