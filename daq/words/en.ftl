### The words of Kerntemp in English.
### Grammar: projectfluent.org. A message's name says where it belongs and what it means; its variables are the
### arguments of `say` in the code. Numbers: NUMBER($x, maximumFractionDigits: 1) rounds.
### Sections follow the rooms, those of the page its views; keep each in alphabetical order.

## general

at-column = column { $column }: { $what }
at-key = { $key }: { $what }
at-key-value = { $key } = { $value }: { $what }
at-line = line { NUMBER($line) }: { $what }
at-place = { $place }: { $what }
csv-cell-too-long = a cell is longer than 131,072 characters
csv-line-end = a line ends with a lone carriage return
csv-quotation-followed = text follows a closing quotation mark
csv-quotation-open = a quotation mark is not closed
database-busy = database is locked
database-damaged = database disk image is malformed
database-disk-failed = disk I/O error
database-full = database or disk is full
database-none = file is not a database
database-not-opened = unable to open database file
database-read-only = attempt to write a readonly database
fault-and-more = { $first }; { $rest }
file-cannot-read = cannot read { $what }: { $reason }
file-cannot-write = cannot write: { $reason }
file-changed = changed or damaged since it was written; write it again, or, to use it as it is, take it out of { $manifest }
file-of-calibrations = the calibration file
file-of-configuration = the configuration
file-of-mapping = the mapping
file-of-press = the press file
file-of-profile = the profile
file-of-resin = the resin file
file-of-run = the run file
json-invalid = not understood from line { NUMBER($line) }, column { NUMBER($column) } on
key-empty = is empty; give at least one
key-missing = is missing; add it
key-no-bool = must be true or false
key-no-day = must be a day, year-month-day, such as 2026-03-04
key-no-instant = must be an instant, such as 2026-03-04T07:00:00Z
key-no-list = must be a list in brackets
key-no-number = must be a valid number
key-no-table = must be a table
key-no-text = must be a text in quotes
key-no-whole-number = must be a valid number without decimals
key-not-finite = must be a finite number
key-one-of = must be { $known }
key-unknown = unknown key; remove it or check its spelling
key-unknown-meant = unknown key; did you mean { $meant }?
limit-greater-than = must be greater than { NUMBER($limit, maximumFractionDigits: 6) }
limit-greater-than-equal = must be greater than or equal to { NUMBER($limit, maximumFractionDigits: 6) }
limit-less-than = must be less than { NUMBER($limit, maximumFractionDigits: 6) }
limit-less-than-equal = must be less than or equal to { NUMBER($limit, maximumFractionDigits: 6) }
list-of-names = { $names }
number-unknown = not known
parquet-none = its end is not that of a Parquet file
parquet-page-damaged = the checksum of a page is wrong
place-line = line { NUMBER($line) }
place-model = model { $version }
place-press = press { $press }
place-row = row { NUMBER($row) }
plain-text = { $text }
system-address-in-use = Address already in use
system-address-not-here = Cannot assign requested address
system-broken-pipe = Broken pipe
system-busy = Device or resource busy
system-connection-refused = Connection refused
system-connection-reset = Connection reset by peer
system-disk-full = No space left on device
system-exists-already = File exists
system-input-output = Input/output error
system-is-a-folder = Is a directory
system-name-too-long = File name too long
system-name-unknown = the host's name is not known
system-no-network = Network is unreachable
system-no-route = No route to host
system-no-such-device = No such device
system-no-such-file = No such file or directory
system-not-a-folder = Not a directory
system-not-allowed = Permission denied
system-read-only = Read-only file system
system-timed-out = Connection timed out
system-too-large = File too large
toml-integer-too-long = a whole number with more than { NUMBER($digits) } digits; shorten it, or put it in quotes if it is a text
toml-invalid = not valid TOML: not understood from line { NUMBER($line) }, column { NUMBER($column) } on
toml-too-deep = tables or lists more than { NUMBER($deepest) } deep within one another; flatten them
toml-twice = not valid TOML: a key or table stands twice, found in line { NUMBER($line) }; remove one

## daq.drivers: loggers, wires, calibration

calibration-entry = entry { NUMBER($number) }: { $what }
calibration-other-tables = only [[calibration]] tables are known, got { $found }
cause-babble = the line never falls silent
cause-busy = busy
cause-closed = closed
cause-connection-refused = connection refused
cause-crc = wrong checksum
cause-driver-fault = fault in the driver
cause-echo = wrong echo
cause-garbage = garbage
cause-no-permission = no permission
cause-no-port = no port
cause-out-of-step = out of step
cause-port-in-use = port in use
cause-port-lost = port lost
cause-refused = refused
cause-silent = silent
cause-surplus = bytes too many
cause-truncated = truncated
cause-unreachable = unreachable
cause-wrong-id = wrong station or number
cause-wrong-shape = wrong shape
connection-closed = the device closed the connection
connection-lost = connection lost: { $reason }
line-babbles = { $place }: the line never falls silent
logger-channels-twice = channels names { $names } twice
logger-check-differs = { $place } station { NUMBER($station) }: { $what } reads { $found }, profile { $profile } expects { $expected }
logger-closed = the logger is closed
logger-needs-address = address is not established for this device; give address
logger-needs-baud = logger { $logger }: baud is not established for this device; give baud
logger-needs-cold-junction = the device reports voltages; give cold_junction_C
logger-no-answer-yet = no answer yet
logger-no-channels = channels names no column
logger-no-reply = { $place }: no reply in { NUMBER($timeout_s) } s; check power, cable and address
logger-of-profile = logger { $logger } ({ $profile })
logger-other-name = { $place }: the instrument calls itself { $found }, expected { $expected }
logger-port-or-host = give either port (such as "/dev/ttyUSB0") or host (such as "192.168.0.21")
logger-refuses-set-up = { $place }: the instrument refuses the set-up: { $fault }
logger-rtu-on-host = transport = "rtu" needs port; over a network use "rtu_over_tcp"
logger-scaling =
    { $given ->
        [yes] scaling '{ $scaling }' is unknown; choose one of: { $known }
       *[no] scaling is not established for this device; choose one of: { $known }
    }
logger-tcp-on-port = transport = "tcp" needs host instead of port
logger-tcp-port-alone = tcp_port needs host
logger-too-many-channels = { NUMBER($channels) } channels, the device has { NUMBER($inputs) } inputs
logger-uncorrected = logger { $logger }: values are not corrected, { $file } is not there yet; kerntemp calibrate --write makes it
modbus-busy =
    { $exception ->
        [4] the device answers exception 4 (device failure)
        [5] the device answers exception 5 (acknowledged, still working)
        [6] the device answers exception 6 (busy)
        [10] the gateway answers exception 10 (no path to the device)
        [11] the gateway answers exception 11 (the device does not answer)
       *[other] the device answers exception { NUMBER($exception) }
    }
modbus-refused =
    { $exception ->
        [1] the device refuses the request: exception 1 (illegal function); the profile does not fit it
        [2] the device refuses the request: exception 2 (illegal address); the profile does not fit it
        [3] the device refuses the request: exception 3 (illegal value); the profile does not fit it
       *[other] the device refuses the request: exception { NUMBER($exception) }; the profile does not fit it
    }
module-checksum =
    { $is_on ->
        [on] has its checksum on; set checksum to match
       *[off] has its checksum off; set checksum to match
    }
module-format = does not write engineering units; set data format 0 in the module
module-name = calls itself { $found }, the profile expects { $expected }
module-refused = { $place } module { $address } { $why }
module-unknown-command = does not know { $command }
port-cannot-connect = cannot connect to { $place }
port-cannot-open = cannot open { $place }
port-lost = port lost: { $reason }
port-no-socket = port { $port }: write socket://host:port, such as socket://192.168.0.50:4001
port-not-opened = { $what }: { $cause }; { $remedy }
port-remedy-connection-refused = the device is on but nothing listens there; check port
port-remedy-no-permission = the user may not open it; add it to the port's group
port-remedy-no-port = check adapter and name
port-remedy-port-in-use = another program has it open; close that
port-remedy-unreachable = nobody answers at this address; check power, cable and host
port-two-settings = { $port }: two loggers on one port ask for different settings: { $first }, { $second }
probe-fits = fits
probe-needs-place = probe: give either --port or --host
probe-not-at-room-temperature = not at room temperature
probe-reads-registers = reading registers of station { NUMBER($station) }, function { NUMBER($function) }
probe-tries-profile = trying { $profile }
profile-bits-wide = values.format = '{ $format }': block.function 1 and 2 bring bits; give 'u16'
profile-block-short = block.count = { NUMBER($count) }, but { NUMBER($inputs) } values end at { NUMBER($end) }
profile-check = check { $what }
profile-needs-tables = protocol { $protocol } needs the table { $tables }
profile-not-established = { $key } is not established for this device; give it as override.{ $key }
profile-same-shape = { $what } has the shape of the value read; a late reply could be mistaken for values: read it in parts
profile-scale-or-code = give either scale, or full_code and full_value
profile-table-missing = profile { $profile } has no table { $table }
profile-unknown = no such profile; known are { $known }, or give the path of a .toml
profile-unknown-meant = no such profile; did you mean { $meant }? Or give the path of a .toml
profile-with-scaling = { $profile } with scaling { $scaling }
registers-float = float
registers-full-scale = { $full } = { NUMBER($celsius) } °C
registers-hundredths = hundredths
registers-low-word-first = { $meaning }, low word first
registers-tenths = tenths
registers-whole-degrees = whole degrees
reply-checksum = checksum is wrong
reply-echo = the local echo differs from what was sent
reply-endless = no end of line in { NUMBER($bytes) } bytes
reply-field-count = { NUMBER($fields) } fields for { NUMBER($channels) } channels
reply-no-configuration = { $reply } is no configuration
reply-no-modbus = the stream holds no Modbus frame
reply-no-open-mask = { $reply } is no mask of open inputs
reply-no-status = { $reply } is no status
reply-no-text = reply { $reply } holds bytes that are no text
reply-no-value = { $reply } is no value
reply-other-channels = channels { $found }, asked { $asked }
reply-other-head = reply begins { $found }, expected { $expected }
reply-other-lead = reply { $reply } to { $command } does not begin { $lead }
reply-other-station = reply of station { NUMBER($found) }, asked { NUMBER($asked) }
reply-out-of-step = { $reply } in the place of the instrument's name: replies out of step
reply-surplus =
    { $bytes ->
        [one] one byte after the end of the reply
       *[other] { NUMBER($bytes) } bytes after the end of the reply
    }
reply-to-others = { $place }: only replies to others came
reply-truncated =
    { $bytes ->
        [one] { $place }: reply breaks off after one byte
       *[other] { $place }: reply breaks off after { NUMBER($bytes) } bytes
    }
reply-value-count = { $reply } is not { NUMBER($values) } values
room-check-no-value = no value
room-check-noisy = noisy
room-check-off = off
room-check-ok = ok
room-check-too-few =
    { $readings ->
        [one] room temperature check: one reading; take at least 2
       *[other] room temperature check: { NUMBER($readings) } readings; take at least 2
    }
simulated-no-device = no simulated device '{ $profile }'; there are { $known }
simulated-no-effect = effect '{ $name }': unknown; known are { $known }
simulated-no-fault = fault '{ $name }': unknown; known are { $known }
simulated-no-input = --open { $given }: { $profile } has inputs 0 to { NUMBER($last) }

## daq.press and daq.files: press file, run file, mapping, header

foreign-cell-count = { NUMBER($cells) } cells, but line { NUMBER($line) } names { NUMBER($columns) } columns
foreign-column-missing = column '{ $column }' of the mapping is not in the file; it has { $found }
foreign-column-twice = column '{ $column }' of the mapping is in the file twice; rename one there
foreign-encoding-unknown = file.encoding = '{ $encoding }' is unknown; try utf-8 or cp1252
foreign-encoding-wrong = not { $encoding } text at byte { NUMBER($byte) }; set file.encoding
foreign-header-empty = header_from.{ $key }: column '{ $column }' holds no value; give the key in [header]
foreign-no-number = { $cell } is not a number with decimal '{ $decimal }'; set file.decimal, or list it in file.missing
foreign-no-rows = no rows follow line { NUMBER($line) }, which names the columns
foreign-no-temperature = { $value } °C is no temperature; must lie between { NUMBER($coldest) } and { NUMBER($hottest) } °C; give the column's unit, or set its lower and upper
foreign-time-falls = { $cell } does not rise; sort the rows, or set time.repeated = "first"
foreign-time-format = { $cell } is not '{ $format }'; set time.format
foreign-time-missing = { $cell } is no time; every row needs one
foreign-too-short =
    { $lines ->
        [one] has one line, but file.header_line = { NUMBER($header_line) }
       *[other] has { NUMBER($lines) } lines, but file.header_line = { NUMBER($header_line) }
    }
foreign-variant-twice = this file's name matches two variants of '{ $of }', '{ $first }' and '{ $second }'; change their patterns so that only one fits
foreign-variant-unknown = this file's name matches none of the mapping's variants of '{ $of }' ({ $known }); add a [[variant]] with what holds for it, or rename the file
frame-column-complex = column { $column } holds complex numbers; give their real part, or a column each
frame-column-levels = the columns' labels have { NUMBER($levels) } levels; join them into one, as in '_'.join
frame-index-levels = { $run }: the index has { NUMBER($levels) } levels ({ $names }); give one run at a time, as in table.loc[name] or table.groupby(level=0), or move levels into columns by reset_index
frame-key-no-text = key { $key } of attrs is not a text; a header's keys are texts
frame-times-here = give a column or an index time_s in seconds, or an index of instants (texts become some by pandas.to_datetime)
frame-times-of-periods = its index is of periods, so take table.to_timestamp()
frame-without-rows = { $run }: the table has no rows; a run needs at least one scan
frame-without-start = the header lacks the time at which the run began; give { $key } as an instant with its time zone, or use time_s
frame-without-times = { $run }: the table has no times; { $remedy } (columns are { $columns })
given-key-no-text = key { $key } is not a text; give names as texts
given-mapping-without-file = { $found }: a mapping explains the file of another logger; give that file's path, or rename the columns of the table and leave the mapping out
given-no-diagnosis = { $found }: a diagnosis is given as what diagnose returned
given-no-effect = { $found }: an effect is given as an Effect
given-no-file = { $found }: a file is given by its path
given-no-header = { $found }: a header is given as a mapping of dotted keys, such as {"{"}"panel.thickness_mm": 16.0{"}"}
given-no-language = language { $language } is not available; choose one of { $languages }
given-no-limits = { $found }: limits are given as a mapping of numbers by name, such as {"{"}"core_least_C": 110.0{"}"}
given-no-mapping = { $found }: a mapping is given as the path of its TOML file
given-no-measurement = { $found }: measurements are given as a list of tuples: a Run, its Moments, and its true coefficients by name
given-no-model = { $found }: a model is given as the path of a model file, a ModelFile, or the result of a fit or a diagnosis
given-no-names = { $found }: names are given as one text or several
given-no-press = { $found }: a press is given as the path of a press file, or as what read_press returned
given-no-press-name = { $found }: the name of a press is given as a text
given-no-ranges = { $found }: ranges are given as a mapping of two numbers by name, such as {"{"}"press_time_s": (60.0, 240.0){"}"}
given-no-resin = { $found }: a resin is given as the path of a resin file, or as a Resin
given-no-run = { $found }: a run is given as the path of a CSV or Parquet file, a pandas table, or a Run; another library's table comes in by its to_pandas()
given-no-scan = { $found }: a scan is given as a mapping of numbers by column, or as a row of a table
given-no-settings = { $found }: settings are given as a mapping of numbers by name, such as {"{"}"press_time_s": 90.0{"}"}
given-no-store = { $found }: a store is given as the path of its file, or as its postgresql:// address
given-no-table = { $found }: a table is given as a pandas DataFrame; another library's comes in by its to_pandas()
given-no-thermal-model = { $found }: a thermal model is given as ThermalModel(press)
given-path-nul = { $path }: the name of no file holds a NUL character; correct the path
header-far-from-table = header key { $key } = { NUMBER($value) } { $unit } lies far from the { NUMBER($table) } { $unit } of { $material } in the material table; check it
header-key-meant = header key { $key } is not known; did you mean { $meant }?
header-key-twice = header key { $key } is given twice; keep one
header-key-unknown = header key { $key } is not known; it is kept, and nothing uses it
header-line-no-toml = '# { $text }' is not 'key = value' in TOML ({ $reason }); put text in quotes, start a remark with '##'
header-material-unknown = material '{ $material }' is not in the table ({ $known }), and its { $missing } is given nowhere; correct the material, or give what is missing
header-missing = header key { $key } is missing; add it to the header, in a file as '# { $key } = ...'
header-missing-material = header key { $key } is missing and material '{ $material }' is not in the table ({ $known }); add it to the header, in a file as '# { $key } = ...'
header-no-number = header key { $key } = { $value }: must be a number; correct the header
header-no-such-place = header key { $key }: the press file has no such place
header-not-finite = header key { $key } = { $value }: must be a finite number; correct it, or remove the key where it is not known
header-number-outside = header key { $key } = { $value }: must be a number from { NUMBER($lower) } to { NUMBER($upper) } { $unit }
header-override = header override: { $what }
header-sd-not-positive = { $key } = { $value }: a standard deviation must be a positive number
header-sd-too-wide = { $key } = { $value }: a standard deviation is at most { $most } { $unit }, the width of what { $base } can be
header-section = '# { $text }': sections are not read; write '# panel.key = value'
header-start-hot = { $key } = { NUMBER($value, maximumFractionDigits: 1) }: hands and room bring no panel above { NUMBER($limit, maximumFractionDigits: 0) } °C; check the start temperature
header-value-kind = header value { $value }: a run file holds text, numbers, true/false, times and lists
manifest-line = not 'SHA-256 sum, two spaces, file'; remove the line
mapping-header-source = header_from.{ $key }.column = '{ $column }': no [[column]] maps to it
mapping-no-zone = must be a time zone such as Europe/Berlin
mapping-target-twice = column.to = '{ $column }' occurs twice; each column of the run file has one source
mapping-term-unknown = computed.to = '{ $to }': no [[column]] leads to its term '{ $column }'
mapping-variant-of-nothing = required_variants: no [[variant]] has of = '{ $of }'
play-pause = pause_s = { $value }: must be a number of seconds, at least 0
play-scans = scans = { $value }: must be a whole number, at least 1
press-boundary-needs-coefficient = kind = "air" needs coefficient, the name of its heat transfer coefficient
press-boundary-needs-column = kind = "measured" needs column, the run file column with its temperature
press-boundary-no-flux-of-run = from_run belongs to kind = "flux", not to { $kind }: it takes the flux from the run's header
press-coefficient-unused = { $name }: no contact or boundary uses it; used are { $used }
press-contact-cannot-part = a layer cannot separate from { $boundary }, which is of kind '{ $kind }'; give one name
press-contact-no-neighbours = not neighbours, listed from bottom to top; possible are { $possible }
press-contact-twice = given twice
press-depth-outside = outside layer '{ $layer }', which is { NUMBER($thickness_mm) } mm thick
press-guess-outside = guess = { NUMBER($guess) } lies outside lower..upper = { NUMBER($lower) }..{ NUMBER($upper) }
press-initial-needs = kind = "uniform" needs temperature_C, or a layer with from_run, whose start it then is
press-layer-needs = needs { $keys } (or from_run = true)
press-layer-outside = no material has { $value }; must be a number from { NUMBER($lower, maximumFractionDigits: 6) } to { NUMBER($upper, maximumFractionDigits: 6) } (layer '{ $layer }')
press-layer-surplus = from_run = true takes its constants from the run; remove { $keys }
press-layer-twice = layer names must differ; { $names } occurs twice
press-no-place = must be LAYER.bottom, LAYER.middle, LAYER.top or {"{"} layer = LAYER, depth_mm = ... {"}"}
press-no-such-layer = no such layer
press-open-above-closed = open_below = { NUMBER($open) } lies above closed_above = { NUMBER($closed) }
press-prior-outside = outside the coefficient's limits { NUMBER($lower) }..{ NUMBER($upper) }
press-prior-unknown = { $name }: no such coefficient; used are { $used }
press-sd-of-nothing = { $key }.sd: there is no number { $key } beside it
press-table-not-rising = a table needs at least one row, its temperatures rising
press-wire-as-temperature = would be read as a temperature, by '{ $pattern }'; rename the channel
press-wire-twice = is the limit switch already; name another column
printed-model = Model { $version } of press { $press }
printed-more = ... and { $count } more
printed-nothing-missing = probability that the model lacks nothing: { NUMBER($percent, maximumFractionDigits: 0) } %, from { $runs } { $runs ->
    [one] run
   *[other] runs
}
printed-panels = panels: { $panels }
printed-press = Press { $press }: { $chain }
printed-run = Run { $run }: { $scans } { $scans ->
    [one] scan
   *[other] scans
}, { $first } to { $last } s
quality-form = { $text }: write column=quality, with one blank between two of them; rename a column that holds other words
quality-no-such-column = { $text } names column { $column }, which is not there; correct the name
quality-unknown = { $text }: { $quality } is no quality; they are { $known }
resin-limits-exclude = core_least_C = { $least } and core_most_C = { $most } exclude each other, so that the press would never open; set core_least_C below core_most_C
resin-one-law = exactly one of the tables [order], [kamal] and [isoconversional] must be given; keep the one that was measured
resin-one-rate = exactly one of rate_per_s (at reference_temperature_C) and prefactor_per_s must be given; leave the other out
resin-rate-impossible = { $key }: with its activation energy the rate at { NUMBER($at_C, maximumFractionDigits: 1) } °C is 10^{ NUMBER($power, maximumFractionDigits: 1) } 1/s; it must lie between 1e-12 and 1e6 1/s. Check that A is in 1/s, that logarithms are natural ones, and energies in kJ/mol
resin-sd-unused = { $key }.sd: nothing uses it; leave it out. The sd of rates, of activation energies and of steam_most_kPa count
resin-table-not-rising = needs at least two rows of conversion, activation energy and ln(A f), the conversions rising between 0 and 1
run-archive-former = a run that an early version archived; it can be read through its store only
run-archive-newer = written by a newer version of Kerntemp; update it
run-cell-count =
    { $cells ->
        [one] 1 cell, but the header row has { NUMBER($columns) } columns; leave a missing value as an empty cell
       *[other] { NUMBER($cells) } cells, but the header row has { NUMBER($columns) } columns; leave a missing value as an empty cell
    }
run-closed-value = { NUMBER($value) } must be 0 (open) or 1 (closed)
run-column-length = column '{ $column }' has another length than time_s
run-column-twice = column '{ $column }' occurs twice (columns { NUMBER($first) } and { NUMBER($second) }); rename one
run-column-type = type { $type } is not a number; store it as float64
run-column-unnamed = column { NUMBER($number) } has no usable name ({ $name }); give every column a name
run-columns-unmatched = no column of run '{ $run }' matches { $pattern }; it has { $columns }
run-file-empty = the file is empty; a run file has '# key = value' lines, a header row, rows
run-header-row-numbers = the header row is missing: found numbers; it starts with time_s, ...
run-in-kelvin = run { $run }: the panel begins at { NUMBER($start, maximumFractionDigits: 1) } °C, and its coldest reading is { NUMBER($coldest, maximumFractionDigits: 1) }: are the readings in kelvin? A mapping with unit = "K" converts them
run-no-commas = cells are not separated by commas; use comma and dot, or import with a mapping
run-no-header-row = the header row is missing; it starts with time_s, ...
run-no-number = { $cell } is not a number; leave a missing value empty
run-no-parquet = not a readable Parquet file ({ $reason }); it is cut short or damaged
run-no-rows = no rows follow the header row; a run needs at least one scan
run-no-temperature = { $value } is no temperature; must lie between { NUMBER($coldest) } and { NUMBER($hottest) } °C; leave a missing value empty
run-no-time = column time_s is missing; found { $found }
run-not-utf8 = not UTF-8 text; save the file as UTF-8
run-number-as-text = { $cell } is a number kept as text; convert the column to floats
run-parquet-rows = { $rows } rows where { $stated } are stated
run-quotation = { $reason }; check its quotation marks and line ends
run-table-empty = the table has no rows; a run needs at least one scan
run-time-falls = time_s = { $time } does not rise ({ $place }: { $before }); sort the rows, remove doubled ones
run-time-missing = the time is missing; every row needs one
run-twice = run '{ $run }' is given twice; each run counts once
run-twice-by-readings = run '{ $run }' holds the readings of run '{ $other }' to the last digit; each pressing counts once: leave one of them out
run-value-infinite = infinite; must be a number
told-by-limit-switch = limit switch
told-by-one-state = press of one state
told-by-pressure-channel = pressure channel
told-by-temperatures = temperatures
told-by-truth = virtual press
told-by-unknown = unknown
wire-closed-face-cold = the { $wire } reports closed, but the upper face is cold; check the { $wire } and the panel
wire-open-face-hot = the { $wire } reports open, but the upper face is hot; check it

## daq.process: configuration

config-closed-twice = channel '{ $channel }' is written from { $wires }; give the logger's channel '{ $channel }' another name
config-column-twice = two loggers fill column '{ $column }'; each column comes from one input
config-header = { $file }: press { $press }
config-logger-twice = two loggers are called '{ $logger }'; give each its own name
config-no-archive = { $key } sets when scans are archived, but there is no archive; name a folder as archive or remove the key
config-no-boundary-channel = no logger has channel '{ $channel }', which boundary.{ $end } of { $file } needs; add it to a logger's channels
config-no-such-press = press '{ $press }' is not in the configuration; it has { $known }
config-no-wire-channel = no logger has channel '{ $channel }', which { $key } names; add it to a logger's channels, or remove { $key }
config-press-twice = two presses are called '{ $press }'; give each its own name
config-pressings-only-too-early = pressings_only_after_days = { $days }: must be more than archive_after_days = { $archived }: scans are archived before they are deleted

## daq.recording: journal of the recorder

buffer-used-already = buffer { $file }: another recorder uses it; stop that one, or give each its own as store.buffer
clock-set = the clock of this machine was set by { $sign }{ NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s; times within a run are not affected
configuration-changed = configuration changed; it takes effect between runs
configuration-in-force = the changed configuration is in force
configuration-needs-start = { $file }: { $changed } changed; restart kerntemp record to apply it
configuration-refused = { $why }; recording goes on with the previous configuration
configuration-stalled = reading { $file }, or a file it names, has stalled; check the drive it is on; recording goes on with the previous configuration
driver-stuck = { $press }: the driver of logger { $logger } has not returned from a read
idle-not-thinned = idle scans are not thinned now: { $why }
logger-back = logger { $logger } answers again
logger-lost = logger { $logger } does not answer: { $why }; recording goes on without it, trying again
logger-problem = { $press }: logger { $logger }: { $why }
needs-start-clock = [clock]
needs-start-presses = the list of presses
needs-start-store = [store]
of-press = press { $press }: { $what }
of-run = run { $run }: { $what }
pages-stalled = the check of { $store } for damage has stalled; check the disk
panel-next-damaged = press { $press }: the data of the next panels are damaged in store { $store } and cannot be read; the run begins without them: enter them again and correct the run's header
panel-not-pressed-before = { $key } = { NUMBER($header_mm, maximumFractionDigits: 1) }: no earlier run of this press had such a panel, the nearest had { NUMBER($nearest_mm, maximumFractionDigits: 1) } mm; the band of the live core covers both; check the thickness
press-recorded-already = press { $press }: another recorder writes it into { $store }; stop that one first
press-stalled = { $press }: no fresh scan for { SPAN($seconds) }
problem-of-press = { $press }: { $what }
recording-begins = recording { $presses }; while the store is unreachable, scans wait in { $where }
recording-ends = recording ends
recording-now = recording { $presses }
run-interrupted = run { $run } was interrupted; its data are kept
scans-begin = press { $press }: scans begin
scans-begin-late = press { $press }: recording begins with a panel that is hot already; if it is being pressed, the rest of that pressing is not stored as a run: its scans are kept like those of an idle press; a limit switch or pressure channel shows it
scans-behind-others = press { $press }: the other recorder has written nothing for { SPAN($seconds) }; what waited here is stored after its scans
scans-left-out = press { $press }: { $count ->
        [one] one scan
       *[other] { $count } scans
    } left out, this machine was too busy
scans-left-out-lately = { $press }: { $count ->
        [one] one scan
       *[other] { $count } scans
    } left out in the last minute, this machine is too busy
scans-lost = { $count ->
        [one] one scan
       *[other] { $count } scans
    } lost: the store was unreachable for longer than there was room
scans-not-written = { $count } scans wait to be written, this machine is too busy
scans-recorded = { $count } scans recorded
store-trouble = { $why } ({ $count } waiting)

## daq.store: the store

archive-clock-ahead = { $press }: the clock is { $days } days past the night before; no archived scans are deleted until the nightly job has run for a month by this clock; check the clock, and correct it if it is wrong
archive-file-damaged = archive file { $file }: no longer what was written; copy it back from a backup of the archive
archive-file-mended = the archive file of run { $run } is sound again
archive-file-missing = archive file { $file }: missing; copy it back from a backup of the archive, or mount the disk it is on
archive-file-newer = archive file { $file }: written by a newer version; update Kerntemp
archive-file-taken = archive file { $file }: exists already with other content, perhaps from another store; give each store a folder of its own as store.archive, or move this file away; nothing was deleted
archive-file-unreadable = archive file { $file }: { $reason }; check the disk and who may read it
archive-folder-lacks = archive { $folder }: lacks { $file }, which was archived in { $before }; mount its disk or copy the archive there, or correct store.archive; nothing was changed
archive-folder-refused = archive { $folder }: { $reason }; create the folder and let the service write to it, or correct store.archive
archive-not-as-written = archive file { $file }: what was read back differs from what was written; check the disk; nothing was deleted
archive-not-written = archive file { $file }: { $reason }; check the disk and its space; nothing was deleted
archive-run-changed = run { $run }: its scans changed while they were archived; nothing was deleted, the next night tries again
archive-run-removed = run { $run }: its scans were deleted on { $date }, as store.pressings_only_after_days asks; its header and its coefficients are kept
backup-damaged = backup { $file }: damaged: { $error }; take another backup
backup-exists = backup { $file }: exists already; give a new name, backups are never overwritten
backup-failed = backup { $file }: { $error }; check the disk and its space
backup-missing = backup { $file }: does not exist
backup-newer = backup { $file }: made by a newer version (schema { $schema }, this one knows { $known }); update Kerntemp
backup-no-folder = backup { $file }: folder { $folder } does not exist; create it
backup-rows-missing = backup { $file }: damaged: rows refer to rows that are not there
backup-run-short = backup { $file }: run { $run } lacks its first or last scan; take another backup
backup-unsound = backup { $file }: not a sound store: { $error }; take another backup
buffer-damaged = buffer { $file } is damaged ({ $error }): set aside as { $aside }; { $kept ->
        [one] one entry could be read and goes on
       *[other] { $kept } entries could be read and go on
    }, { $lost } { $lost ->
        [one] is
       *[other] are
    } lost; recording goes on
buffer-damaged-uncounted = buffer { $file } is damaged ({ $error }): set aside as { $aside }; { $kept ->
        [one] one entry could be read and goes on
       *[other] { $kept } entries could be read and go on
    }; how many are lost is not known, { $lost } at least; recording goes on
buffer-emptied = buffer { $file }: somebody deleted it; { $count ->
        [one] one entry is
       *[other] { $count } entries are
    } lost; recording goes on
buffer-gone = buffer { $file } is gone ({ $error }): created again; { $lost ->
        [one] one entry is
       *[other] { $lost } entries are
    } lost; recording goes on
buffer-place-is-folder = store.buffer = { $file }: is a folder; give a file in it
buffer-place-no-folder = store.buffer = { $file }: folder { $folder } does not exist; create it, or give another file
buffer-place-no-permission = no permission to read and write
buffer-place-refused = store.buffer = { $file }: { $reason }; check its folder's owner and mount and the space on its disk, or give another file
buffer-refuses = buffer { $file }: { $error }; free space on its disk
buffer-rows-unreadable =
    { $count ->
        [one] buffer { $file }: one entry cannot be read ({ $error }); it is set aside in { $aside }
       *[other] buffer { $file }: { $count } entries cannot be read (the first: { $error }); they are set aside in { $aside }
    }
buffer-sum-wrong = its checksum is wrong
buffer-unusable = buffer { $file }: { $error }; check its disk and folder, or give another file as buffer of [store]; recording goes on, but while the store is away scans wait in memory
event-twice = press { $press }: { $kind } is recorded at another moment of scan { $scan } already; the second is not kept as an event
events-lost = press { $press }: { $count ->
        [one] one press event
       *[other] { $count } press events
    } lost: the store was unreachable for longer than there was room
item-set-aside = press { $press }: the store does not take { $what }: { $why }; set aside in { $aside }, everything else is written
left-unwritten =
    { $count ->
        [one] one entry is not written: store { $store } does not take it; it is lost when this process ends
       *[other] { $count } entries are not written: store { $store } does not take them; they are lost when this process ends
    }
line-set-aside = the store does not take a line of the journal; it is set aside in { $aside }
model-from-sisters = learned from { $count ->
    [one] one press
   *[other] { $count } presses
} of the same kind: { $sisters }
model-promoted = model { $version } promoted
model-rolled-back = rolled back
model-through-api = through the API
model-version-missing = model version '{ $version }' is not in the store
model-version-taken = model version '{ $version }' is in the store already; versions never change
process-failed = { $process } has ended: { $why }
recipe-damaged = recipe { $recipe } is damaged in store { $store } and cannot be read; give its values again under the same name
recipe-unknown = there is no recipe '{ $recipe }'; there are: { $known }
restore-differs = store { $store }: holds { $found } after restoring, the backup { $expected }
run-end-without-run = run { $run } ends at scan { $scan }, but the store has no such run; its scans are kept
run-renamed = run { $run } is in the store already; this pressing is stored as { $name }
run-short = run { $run } lacks its first or last scans in the store; it now counts as interrupted and has those that are left, an older backup may hold all of them
scans-given-up = the store has been unreachable for too long: the oldest waiting scans are dropped; buffer: { $where }
scans-wait = { $why }; scans wait in { $where }
set-aside-begin = the beginning of run { $run } with all of its header
set-aside-scans = a scan with its events
sign-of-life-refused = { $why }; recording goes on, but the recorder's sign of life is not stored: health and page call it silent
store-back = store { $store } takes data again; everything kept is written
store-column-missing = run '{ $run }' has no column '{ $column }'; it has { $columns }
store-cursor = cursor '{ $cursor }': not a cursor of this list; take next_cursor of the page before
store-damaged = store { $store }: the file is damaged: { $error }; take a backup of what can be read, then restore the newest sound one with kerntemp backup --restore
store-file-gone = store { $store }: the file was deleted or moved; a running kerntemp record puts it back, else restore the newest backup
store-foreign-view = store { $store }: view { $view } is not Kerntemp's and depends on one that this version changes; drop it, start again, and create it again
store-gives-no-reason = it gives no reason
store-header-damaged = its header is damaged in store { $store } and cannot be read; the other runs can; restore a backup beside the store with kerntemp backup --restore and take the run from there
store-header-wrong = { $file }: header key { $key } = { $value }: must be { $wanted }; correct it or remove the key
store-is-closed = store { $store }: is closed; open it again by daq.open_store
store-is-folder = store { $store }: is a folder; give the path of a file in it
store-missing = store { $store }: does not exist; start kerntemp record, or give the right path
store-newer = store { $store }: made by a newer version (schema { $schema }, this version knows { $known }); update Kerntemp or give another store
store-no-folder = store { $store }: folder { $folder } does not exist; create it
store-not-empty = store { $store }: holds data; restore only into a new place
store-not-sqlite = store { $store }: not an SQLite file, or its first page is destroyed; restore the newest backup with kerntemp backup --restore, or give another path
store-nul = store { $store }: a text holds a NUL character, which a server cannot keep; remove it
store-overwritten = store { $store }: an older copy was written over it in its place; recording goes on there, with what memory still had; what else was recorded since the copy is not in it any more
store-press-gone = store { $store }: press { $press } is not in it any more, another store or an older one is in its place; recording goes on there, what the store held before is only in what was moved away or in a backup
store-refuses = store { $store }: { $reason }
store-refuses-remedy = store { $store }: { $reason }; { $remedy }
store-remedy-damaged = the file is damaged; restore the newest backup with kerntemp backup --restore
store-remedy-database = create the database, or correct the URL
store-remedy-disk-failed = the disk failed; check it and its space, restore the newest backup if the file is damaged
store-remedy-folder = check that the folder exists, may be written, and its disk is not mounted read-only
store-remedy-full = free space on the disk; recording goes on by itself
store-remedy-lock-timeout = another session holds a table; end it
store-remedy-locked = another process holds it; close other programs that have the file open
store-remedy-password = check user and password in the URL
store-remedy-read-only = no permission to write; check owner and mount of the file and its folder
store-remedy-server = check that the database server runs and is reachable
store-remedy-server-damaged = the server's data are damaged; repair an index with REINDEX there, else restore the newest backup with kerntemp backup --restore
store-remedy-server-permission = the user may not write there any more; grant it the rights again
store-remedy-server-read-only = the server takes no changes, as a standby does; let it take them again, or correct the URL
store-remedy-server-tables = a table or column is missing; finish the restore, or restore the newest backup with kerntemp backup --restore
store-rescued = store { $store }: the file was deleted, moved or exchanged; all of it is written to its place again and recording goes on there
store-rescued-beside = store { $store }: another store was put in its place; that one is set aside as { $aside }, all of the recorded one is written again and recording goes on there
store-rescued-cut = store { $store }: its log (-wal) was emptied or cut short; the file is written again without it, with { $count ->
        [one] the one newest entry
       *[other] the { $count } newest entries
    } of the recorder; what other processes stored in the last seconds may be lost; the file as found is set aside as { $aside }
store-rescued-log = store { $store }: its log (-wal, -shm) was deleted or exchanged; all of it is written again and recording goes on there; the file without its newest entries is set aside as { $aside }
store-run-missing = run '{ $run }' is not in the store; kerntemp export lists runs, a file needs its path
store-run-missing-here = run '{ $run }' is not in store { $store }; runs() lists those that are
store-run-name = { $file }: header key run = { $name }: must be a name of 1 to 200 bytes without slashes, line breaks, characters that nobody sees, or blanks at its ends; nothing was imported
store-run-renamed = run '{ $run }': the name of a run cannot change
store-run-taken = { $file }: run '{ $run }' is in the store already; nothing was imported; change the header key run
store-scan-damaged = scan { NUMBER($scan, useGrouping: 0) } is damaged in store { $store } and cannot be read; the other runs can; restore a backup beside the store with kerntemp backup --restore and take the run from there
store-scan-taken = press { $press }: scan { $scan } is there already with other values; another recorder writes to this press: stop one of them
store-scans-damaged = its scans are damaged in store { $store } and cannot be read; restore a backup beside the store with kerntemp backup --restore and take the run from there
store-scans-missing = scans of it are missing in store { $store }; restore a backup beside the store with kerntemp backup --restore and take the run from there
store-taken-over = store { $store }: nothing is left of the file that was recorded into; recording goes on in what lies in its place now
store-trying-again = { $why }; trying again
store-url-at = the password in the store's url holds an @: write it as %40
store-url-mistyped = the store's url is neither a file path nor a whole URL (not shown: it may hold a password); give a file path or postgresql://user:password@host/name
store-url-no-file = store url '{ $url }': processes meet in the store, so it needs a file path
store-url-unsupported = store url '{ $url }': { $engine } is not supported; give a file path or postgresql://...
store-url-wrong = store url '{ $url }': not a URL; give a file path or postgresql://user@host/name
store-went-back = store { $store }: it has gone back to an older state, as after a restored backup or with a server that took over; scans { NUMBER($first, useGrouping: 0) } to { NUMBER($last, useGrouping: 0) } of press { $press }, with what belonged to them, were written and are not in it any more; look for them in the state that was replaced
store-without-tables = store { $store }: its tables are missing or not all there, as while a backup is being restored; finish that, or start kerntemp record again, which begins an empty store there
thread-failed = { $thread }: { $why }; it is restarted
thread-stalled = { $thread }: no progress for { SPAN($seconds) }; restart the service
unexpected-error = unexpected fault ({ $kind }: { $error }); please report it
waits-in-buffer = { $file }, enough for { NUMBER($hours, maximumFractionDigits: 0) } h
waits-in-memory = memory, enough for { NUMBER($hours, minimumFractionDigits: 1, maximumFractionDigits: 1) } h
wanted-one-of = one of { $names }
wanted-seconds = a number of seconds
wanted-text = text
wanted-time = a time with its zone between the years 1970 and 9999, as 2026-03-04T07:00:00Z
writer-dead = the writer to the store does not run
writer-stalled = the writer to the store has not moved for { SPAN($seconds) }

## softsensor.effects: the catalogue of effects

body-air = air
body-panel = panel
body-plate = plate
body-plate-lower = lower plate
body-plate-upper = upper plate
body-platen = platen
body-platen-lower = lower platen
body-platen-upper = upper platen
coupling-always = { $one } – { $other }
coupling-and = { $first } and { $second }
coupling-closed = { $one } – { $other }, closed
coupling-open = { $one } – { $other }, open
coupling-surroundings-bottom = bottom face – surroundings
coupling-surroundings-top = top face – surroundings
effect-chance-impossible = effect { $name }: chance = { $value }: it is a probability from 0 to 1
effect-clock_offset-called = clocks that differ
effect-clock_offset-confirmed-by = Touch a platen and a panel thermocouple at once with a soldering iron and compare.
effect-clock_offset-core = None by itself, but it biases the contact coefficients.
effect-clock_offset-meaning = The panel channels are stamped later (or earlier) than the platen channels and the limit switch.
effect-clock_offset-symptom = Every kink of the panel readings is late by the same time, at closing and at opening.
effect-conductivity_offset-called = conductivity other than nominal
effect-conductivity_offset-confirmed-by = Measure k of this board, or press panels of different thickness.
effect-conductivity_offset-core = The core is hotter (ratio above 1) or cooler by about 1 K for every 5 %.
effect-conductivity_offset-meaning = The panel's conductivity differs from the value in the run's header.
effect-conductivity_offset-symptom = Faces depart from the simulation in proportion to the square root of time, in every state.
effect-conductivity_temperature-called = conductivity that changes with temperature
effect-conductivity_temperature-confirmed-by = Measure k at 25 and 100 °C (guarded hot plate), or press a panel with a core thermocouple.
effect-conductivity_temperature-core = With a rising conductivity the core is 1 to 4 K hotter than simulated.
effect-conductivity_temperature-meaning = The panel conducts heat differently when hot than at room temperature.
effect-conductivity_temperature-symptom = Late in the pressing and after opening the faces drift away from the simulation, more so for thick panels.
effect-contact_asymmetry-called = upper and lower contact that differ
effect-contact_asymmetry-confirmed-by = Turn the panel over, or exchange the press plates.
effect-contact_asymmetry-core = Below 1 K in the middle; the hottest plane moves off it.
effect-contact_asymmetry-meaning = Upper and lower contact differ while the press is closed; the coefficient is their geometric mean.
effect-contact_asymmetry-symptom = After closing one face runs above the simulation and the other below.
effect-contact_buildup-called = contact that grows after closing
effect-contact_buildup-confirmed-by = Repeat with bare panels and with twice the closing speed; log pressure.
effect-contact_buildup-core = Small, some tenths of a kelvin, but it biases the coefficients by a factor of up to 1.8.
effect-contact_buildup-meaning = The contact between press and panel grows for some seconds after closing (resin melts and flows).
effect-contact_buildup-symptom = The faces rise more slowly than simulated in the first seconds after closing, then catch up.
effect-contact_load-called = contact that depends on pressure
effect-contact_load-confirmed-by = Repeat at three pressures with everything else the same.
effect-contact_load-core = Below 1 K; it matters when the pressure is changed.
effect-contact_load-meaning = A contact improves with pressure.
effect-contact_load-symptom = Residuals after closing change sign between runs at low and at high pressure.
effect-density_profile-called = faces denser than the middle
effect-density_profile-confirmed-by = Measure the density profile (X-ray), or press a panel with a core thermocouple.
effect-density_profile-core = The core is 1 to 3 K off, since its layers hold less heat and conduct less.
effect-density_profile-meaning = The panel's faces are denser than its middle; density and conductivity follow 1 + a (z^4 - 0.2).
effect-density_profile-symptom = Faces take up more heat than simulated just after closing and less later.
effect-edge_loss-called = heat lost at the rim
effect-edge_loss-confirmed-by = Insulate the rim, or compare sensors at the rim with sensors in the middle.
effect-edge_loss-core = The core is 2 to 4 K cooler than simulated in a long pressing.
effect-edge_loss-meaning = Heat leaves through the rim of the panel.
effect-edge_loss-symptom = Long pressings settle below the simulation; rim sensors read lower than centre ones.
effect-entry-not-an-effect = entry point { $name } = { $value }: not a softsensor.effects.Effect
effect-exists-already = entry point { $name }: there is an effect called { $effect } already
effect-heat_capacity_offset-called = heat capacity other than nominal
effect-heat_capacity_offset-confirmed-by = Weigh and measure the panel; measure its heat capacity; press panels of different thickness.
effect-heat_capacity_offset-core = The core is cooler (ratio above 1) or hotter by about 1 K for every 5 %.
effect-heat_capacity_offset-meaning = The panel's density times heat capacity differs from the value in the run's header.
effect-heat_capacity_offset-symptom = Faces depart from the simulation in every state, least in thick panels early on.
effect-heat_capacity_temperature-called = heat capacity that changes with temperature
effect-heat_capacity_temperature-confirmed-by = Measure c at 20 to 100 °C (DSC), or press a panel with a core thermocouple.
effect-heat_capacity_temperature-core = With a rising heat capacity the core is 1 to 2 K cooler than simulated.
effect-heat_capacity_temperature-meaning = The panel needs more heat per kelvin when hot than at room temperature.
effect-heat_capacity_temperature-symptom = The faces cool more slowly after opening than simulated while heating up fits.
effect-initial_press_state-called = plates not yet back at rest temperature
effect-initial_press_state-confirmed-by = Wait two minutes between pressings, or tape a thermocouple to a press plate.
effect-initial_press_state-core = Below 0.5 K.
effect-initial_press_state-meaning = The press plates are still cooler (or warmer) than at rest when the panel is inserted.
effect-initial_press_state-symptom = The lower face departs from the simulation at insertion, and the deviation fades within a minute.
effect-moisture_evaporation-called = evaporating moisture
effect-moisture_evaporation-confirmed-by = Weigh the panel before and after pressing, or press one dried to zero moisture.
effect-moisture_evaporation-core = The core heats more slowly than simulated once steam forms: several kelvin too low.
effect-moisture_evaporation-meaning = Water evaporates in the panel, leaves it, and takes latent heat along.
effect-moisture_evaporation-symptom = Readings stop rising or lag behind near 85 to 115 °C and stay below the simulation afterwards.
effect-name-impossible = effect { $effect }: { $name } is no name; it takes letters from a to z, digits and _, a letter first
effect-not-in-catalogue = effect { $name } is not in the catalogue; known are { $known }
effect-open_radiation-called = radiation in the open press
effect-open_radiation-confirmed-by = Hold a sheet of aluminium foil between panel and upper plate before closing.
effect-open_radiation-core = Below 0.2 K.
effect-open_radiation-meaning = While the press is open, the hot upper plate radiates onto the panel.
effect-open_radiation-symptom = The upper face is warmer than simulated in the open press, before closing and after opening.
effect-paper_layer-called = an insulating paper layer
effect-paper_layer-confirmed-by = Press the same board bare.
effect-paper_layer-core = Some tenths of a kelvin.
effect-paper_layer-meaning = The impregnated paper on both faces insulates and stores heat.
effect-paper_layer-symptom = Faces respond to closing later than simulated, and the coefficient of the open press is estimated too low.
effect-parameter-limits = effect { $name }: parameter { $parameter }: lower = { $lower } and upper = { $upper } are no limits; give two numbers, lower the smaller one
effect-parameter-outside = effect { $name }: parameter { $parameter }: { $what } = { $value } lies outside its limits { $lower } to { $upper }
effect-parameter-twice = effect { $name }: there are two parameters { $parameter }; give each a name of its own
effect-parameter-without-size = effect { $name }: parameter { $parameter }: typical equals neutral; the first parameter is the effect's size, so that typical differs from its absence
effect-parameters-missing = effect { $name }: give its parameters as a tuple of one Parameter or more
effect-platen_offset-called = a platen reading that is off
effect-platen_offset-confirmed-by = Compare the platen thermocouples with a calibrated one at working temperature.
effect-platen_offset-core = About 0.3 K for each kelvin.
effect-platen_offset-meaning = The platen thermocouples read too low (positive) or too high (negative) by a constant.
effect-platen_offset-symptom = At the end of a long pressing both faces are away from the simulation, in proportion to the heat taken up.
effect-resin_cure-called = heat of the curing resin
effect-resin_cure-confirmed-by = Press the same panel a second time: cured resin gives no more heat.
effect-resin_cure-core = Small: some tenths of a kelvin.
effect-resin_cure-meaning = The resin releases reaction heat at both faces while it cures.
effect-resin_cure-symptom = The faces overshoot the simulation in the first 5 to 30 s after closing, then return.
effect-sensor_fault-called = a faulty sensor
effect-sensor_fault-confirmed-by = Check the named thermocouples: fixing, polarity, plug position.
effect-sensor_fault-core = None: the channel is left out.
effect-sensor_fault-meaning = Single channels are loose, drifting or swapped.
effect-sensor_fault-symptom = One channel departs from its neighbours on the same face.
effect-shipped = effect { $name }: Kerntemp brings one of that name, which stays; give yours another name
effect-terms-contacts = closed_contact is { $found }; it takes factors by the number of a contact, 0 to { $most }
effect-terms-fail = effect { $name }: its terms fail ({ $problem }); its values are { $known }
effect-terms-kinds = { $term } are { $found }; they are a tuple of { $kind }
effect-terms-no-number = { $term } is { $found }, not a number
effect-terms-no-pair = { $term } is { $found }; it takes a tuple of two numbers
effect-terms-none = effect { $name }: its terms are { $found }; let it return Terms(...)
effect-terms-not-finite = { $term } is not finite
effect-terms-shape = { $term } has the shape { $found }; it takes { $wanted }
effect-terms-wrong = effect { $name }: of its terms { $what }
effect-thermocouple_footprint-called = panel sensors that read a mixture
effect-thermocouple_footprint-confirmed-by = Use thinner wire, or put one thermocouple under a sheet of foil.
effect-thermocouple_footprint-core = Below 0.1 K, but it biases the contact coefficients.
effect-thermocouple_footprint-meaning = While closed, the panel's thermocouples read a mixture of panel face and press face.
effect-thermocouple_footprint-symptom = Readings jump upwards at closing and downwards at opening by a share of the contact's drop.
effect-thermocouple_lag-called = panel sensors that respond late
effect-thermocouple_lag-confirmed-by = Dip one thermocouple into hot water and log its step response.
effect-thermocouple_lag-core = None by itself, but it biases the contact coefficients by a factor of up to 3.
effect-thermocouple_lag-meaning = The panel's thermocouples respond late.
effect-thermocouple_lag-symptom = Readings trail the simulation in proportion to their slope, most of all in the second after closing.
effect-vapour_convection-called = steam that carries heat
effect-vapour_convection-confirmed-by = Press one sacrificial panel with a thermocouple in its middle.
effect-vapour_convection-core = The core is hotter than simulated, typically by 2 to 7 K.
effect-vapour_convection-meaning = While the press is closed, steam carries heat from layers above 100 °C into cooler ones.
effect-vapour_convection-symptom = The surfaces need more heat than simulated while closed; the core runs ahead by kelvins.
effect-without-words = effect { $name }: no English words for { $lacking }; give them in its `words`
parameter-amount = { $value } { $unit }
parameter-clock_offset-seconds = panel channels later than platen channels by
parameter-conductivity_offset-ratio = conductivity of the panel
parameter-conductivity_temperature-per_100_K = rise of the conductivity per 100 K
parameter-contact_asymmetry-ratio = upper contact
parameter-contact_buildup-deficit = share of the contact still missing at closing
parameter-contact_buildup-time_constant_s = time constant of its growth
parameter-contact_load-exponent = the contact grows with the pressure to the power of
parameter-density_profile-amplitude = faces denser than the middle by
parameter-edge_loss-W_m3K = heat lost at the rim, per volume and kelvin above ambient
parameter-heat_capacity_offset-ratio = heat capacity of the panel
parameter-heat_capacity_temperature-per_100_K = rise of the heat capacity per 100 K
parameter-initial_press_state-offset_K = plates at the start, above their steady temperature by
parameter-interval = { NUMBER($low, maximumSignificantDigits: 3) } to { NUMBER($high, maximumSignificantDigits: 3) }
parameter-law-coldest_C = lowest temperature of the curve
parameter-law-hottest_C = highest temperature of the curve
parameter-law-last_s = latest time since closing
parameter-law-least_load = lowest pressure over its reference
parameter-law-level = logarithm of the factor at the latest time
parameter-law-most_load = highest pressure over its reference
parameter-law-strength = strength, 1 as found
parameter-law-value = value at knot { $knot }
parameter-line = { $words } ({ $name }): { $amount }
parameter-line-within = { $line } (95 %: { $between })
parameter-moisture_evaporation-moisture_percent = water that evaporates
parameter-moisture_evaporation-temperature_C = temperature from which it evaporates
parameter-open_radiation-emissivity = effective emissivity of press and panel
parameter-paper_layer-capacity_J_m2K = heat capacity of the paper
parameter-paper_layer-resistance_m2K_W = thermal resistance of the paper
parameter-platen_offset-bottom_K = lower platen hotter than its reading by
parameter-platen_offset-top_K = upper platen hotter than its reading by
parameter-resin_cure-autocatalysis = share of the curing speed that comes only as it cures
parameter-resin_cure-heat_kJ_m2 = reaction heat of the resin
parameter-resin_cure-temperature_C = temperature at which half-cured resin cures by 3 % a second
parameter-thermocouple_footprint-weight = share of the press face in the reading
parameter-thermocouple_lag-time_constant_s = time constant of the panel sensors
parameter-vapour_convection-W_m3K = heat carried by steam, per volume and kelvin above 100 °C
place-bottom = { $body }, bottom face
place-depth = { $body }, { NUMBER($depth_mm, maximumFractionDigits: 4) } mm from its bottom
place-middle = { $body }, middle
place-top = { $body }, top face
unit-kilojoule-per-face = kJ/m² per face
unit-percent-of-dry-mass = % of dry mass
unit-percent-of-mean = % of the mean
unit-percent-of-value-at-20-degrees = % of the value at 20 °C
unit-times-nominal = times nominal
unit-times-the-lower-contact = times the lower one

## softsensor.heat: the model and what a run must offer

boundary-column-missing = { $run }: column '{ $column }' is missing; boundary.{ $end } needs it (the run has { $columns })
boundary-empty = { $run }: column '{ $column }' holds no value; boundary.{ $end } needs it
boundary-gap = { $run }: column '{ $column }' is empty for { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s around time_s = { $time }; at most { NUMBER($most, maximumFractionDigits: 6) } s of boundary.{ $end } are bridged: cut the run there
boundary-impossible = { $run }: column '{ $column }' = { $value } °C at time_s = { $time }: boundary.{ $end } must lie between { NUMBER($lower, maximumFractionDigits: 6) } and { NUMBER($upper, maximumFractionDigits: 6) } °C; empty the cell
coefficient-impossible = { $where }: { $name } = { $value }: must be a number from { NUMBER($lower, maximumFractionDigits: 6) } to { NUMBER($upper) } W/m²K
coefficient-missing = coefficient { $name } is missing; give all of { $all }
coefficient-negative = { $name } = { $value } W/m²K: must be a finite number, at least 0
coefficient-unknown = { $where }: { $name }: press '{ $press }' has no such coefficient; it has { $known }
header-ambient-impossible = { $run }: header key ambient.temperature_C = { $value }: must be a number from { NUMBER($lower, maximumFractionDigits: 6) } to { NUMBER($upper, maximumFractionDigits: 6) }
header-pressure-impossible = { $run }: header key setting.pressure_N_cm2 = { $value }: must be a number above 0 N/cm²; correct it, or leave it out where it is not known
header-table-not-rising = header key { $key }: the temperatures of its table do not rise from row to row
header-table-rows = header key { $key } = { $value }: a table has rows of a temperature and a value, [[20, 0.12], [100, 0.14]]
header-unseen = header key { $key } = { $value }: holds characters that nobody sees; type it again
header-verdict = { $key } = { $value } is no verdict; one of { $known }
layer-from-run-without-panel = layer '{ $layer }' takes its constants from the run, and there is no panel
layer-incomplete = layer '{ $layer }' lacks density or thickness
live-sensor-of-press = live sensor of press { $press }
live-time-no-number = a scan at { $time }: its time is given in seconds, as a number; of a table indexed by instants give the seconds since its first row
live-time-not-rising = a scan at { NUMBER($time_s, maximumFractionDigits: 3) } s after one at { NUMBER($newest_s, maximumFractionDigits: 3) } s: times must rise; begin a new LiveSensor for another run
live-value-no-number = column { $column }: { $value } is not a number; give NaN or None for a missing value
load-column-empty = { $run }: load column '{ $column }' holds no value above 0: { $contacts } taken as independent of load; give the column, or take load out of the press file
load-column-missing = { $run }: load column '{ $column }' is missing (it has { $columns }): { $contacts } taken as independent of load; give the column, or take load out of the press file
load-gap = { $run }: load column '{ $column }' is empty for { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s around time_s = { $time }; at most { NUMBER($most, maximumFractionDigits: 6) } s of a load are bridged: cut the run there, or leave the column out
load-impossible = { $run }: load column '{ $column }' = { $value } at time_s = { $time }: must be a finite number, not below 0; empty the cell, or correct the column's sign or zero
load-zero-while-closed = { $run }: load column '{ $column }' = { $value } at time_s = { $time }, where the press is closed: must be above 0; empty the cell, or correct the column's sign or zero
model-file-covariance = { $file }: covariance of { $row } and { $column } = { $value }: no covariance matrix has that there; leave the key covariance out, or fit again
model-file-covariance-of = { $file }: covariance.names has { $name }, which the file gives no value of; it gives { $known }
model-file-covariance-shape = { $file }: covariance.matrix is { $shape }, and covariance.names has { $names }; it must have a row and a column for each name
model-file-effect-outside = { $file }: effects.{ $number }.parameters.{ $name } = { $value } ({ $effect }) lies outside its limits { NUMBER($lower, maximumFractionDigits: 9) } to { NUMBER($upper, maximumFractionDigits: 6) } { $unit }
model-file-effect-twice = { $file }: effects.{ $number }: { $effect } stands in effects twice; keep one
model-file-effect-unnamed = { $file }: effects.{ $number } has no name
model-file-effect-without-size = { $file }: effects.{ $number }: { $effect } has no size; give under parameters { $known }
model-file-effect-wrong = { $file }: effects.{ $number }.parameters ({ $effect }): { $what }
model-file-key-meant = { $file }: key '{ $key }' is not known; did you mean { $meant }?
model-file-no-coefficients = { $file }: not a model file: key 'coefficients' is missing
model-file-no-json = { $file }: not a JSON model file: { $error }
model-file-no-numbers = { $file }: { $place } = { $value }: needs numbers value and sd
model-file-no-table = { $file }: { $place } must be an object of NAME: {"{"}value, sd{"}"}
model-file-of-another-press = { $path } is of press '{ $other }', the press file is of '{ $press }': coefficients of another press make a wrong core look certain; fit this press's own runs
model-file-parameter-unknown = { $file }: effects.{ $number }.parameters.{ $name }: { $effect } has { $known }
model-file-part = { $file }: { $key } is not as fit, diagnose and the nightly job write it; correct it, or leave the key out
model-file-scatter = { $file }: scatter.{ $key }.sd = { $value }: a share of the header's value, above 0 and at most { NUMBER($most, maximumSignificantDigits: 3) }, by which it comes from the one of its limits to the other
model-file-sd = { $file }: { $place }.sd = { $value }: a standard deviation must be a number, at least 0
model-file-unreadable = { $file }: cannot read the model file: { $error }
parameter-unknown = '{ $name }' is no parameter of this model; it has { $known }
run-moments-out-of-order = { $run }: { $later } = { $late } lies before { $earlier } = { $early }; check column closed
run-ramp-impossible = { $run }: ramp_s = { $value }: closing takes a finite time, at least 0 s
run-rows-far-apart = { $run }: rows are { NUMBER($seconds, maximumFractionDigits: 0) } s apart by time_s, at most { NUMBER($most, maximumFractionDigits: 6) } s can be: is time_s in milliseconds? It must be in seconds
run-rows-missing = { $run }: no row for { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s after time_s = { $time }; at most { NUMBER($most, maximumFractionDigits: 6) } s of a measured boundary are bridged: cut the run there
run-times-fall = { $run }: time_s = { $time } follows { $before } (row { $row }): times must rise; correct the row
run-too-short =
  { $run }: column time_s has { NUMBER($rows) } { $rows ->
    [one] row
   *[other] rows
  }; a run needs at least two
sensor-outside-layer = { $run }: a sensor at depth_mm = { NUMBER($depth_mm, maximumFractionDigits: 6) } lies outside layer '{ $layer }', { NUMBER($thickness_mm, maximumFractionDigits: 6) } mm thick in this run; correct its place or the thickness
solve-exact-contact-changes = method = 'exact': a contact changes while the press is closed; use the implicit solver
solve-exact-moments-too-near = method = 'exact': fewer than four steps in { NUMBER($seconds, maximumFractionDigits: 6) } s between two moments of the press; use the implicit solver
solve-exact-not-linear = method = 'exact': { $what } is not linear; use the implicit solver
solve-impossible = { $run }: these contacts and sources lead to { $found } °C, not between { NUMBER($coldest, maximumFractionDigits: 2) } and { NUMBER($hottest, maximumFractionDigits: 0) } °C; no material has such values, so check them
solve-no-temperatures = { $run }: these contacts and sources lead to no finite temperatures; no material has such values, so check them
solve-table-or-radiation = a property table or radiation
solve-unknown-method = method = { $method }: must be 'implicit' or 'exact'
solve-value-out-of-range = { $name } = { $value }: must be a number from { NUMBER($lower, maximumFractionDigits: 6) } to { NUMBER($upper, maximumFractionDigits: 6) }
start-layer-without-channel = { $run }: [initial] kind = "sensors" needs a reading in layer '{ $layer }', where the run has no channel that a [[sensor]] of the press file names: add one, or give kind = "steady" or "uniform"
start-layer-without-reading = { $run }: [initial] kind = "sensors" needs a reading in layer '{ $layer }'; { $columns } are empty: fill one, or give kind = "steady" or "uniform"
start-no-readings = { $run }: [initial] kind = "sensors" needs a reading; all panel columns are empty
start-not-steady = { $run }: { $why }; give [initial] kind = "uniform" with temperature_C, or "sensors", or correct the boundaries and contacts
start-not-steady-steep = its steady temperatures cannot be found: properties or radiation change too steeply with temperature
start-not-steady-untied = layer '{ $layer }' exchanges heat with nothing of a given temperature, so it has no steady temperature
start-not-steady-untied-without-panel = layer '{ $layer }' exchanges heat with nothing of a given temperature while no panel is in, so it has no steady temperature
value-at-least = { $name } = { $value }: must be a finite number, at least { NUMBER($least, maximumFractionDigits: 6) }
value-at-most = { $name } = { $value }: must be a finite number, at most { NUMBER($most, maximumFractionDigits: 6) }
value-between = { $name } = { $value }: must be a finite number, at least { NUMBER($least, maximumFractionDigits: 6) }, at most { NUMBER($most, maximumFractionDigits: 6) }
value-not-finite = { $name } = { $value }: must be a finite number

## softsensor.signals: channels

channel-departs = { $column } reads { NUMBER($kelvin, maximumFractionDigits: 0) } K { $side ->
    [below] below
   *[above] above
 } its neighbours and is not used in { $run }
channel-drifting = channel { $column } drifts away from its face, by { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K rms, and is left out
channel-empty = channel { $column } holds no usable value and is left out
channel-loose = channel { $column } departs from its face by { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K rms: it may be loose, and is left out
channel-swapped = channel { $column } follows another place ({ $place }): was it swapped? It is left out
run-no-panel-channel =
    { $count ->
        [0] { $run }: the press file has no sensor to fit with; give it one without role = "validation"
       *[other] { $run }: no usable panel channel; the press file's sensors name { $named }
    }
run-press-state-unknown = { $run }: press state unknown: no reading of the panel and no column 'closed'; add one of them, or take a press file without open contacts

## softsensor.fitting: fits, warnings, what to measure

fit-cells-dropped =
    { $count ->
        [one] { $count } single cell departed from its face and was left out
       *[other] { $count } single cells departed from their face and were left out
    }
fit-cells-jump =
    { $count ->
        [one] channel { $column }: { $count } single cell jumps by more than { $kelvin } K and is left out
       *[other] channel { $column }: { $count } single cells jump by more than { $kelvin } K and are left out
    }
fit-closed-again = from { NUMBER($at, minimumFractionDigits: 1, maximumFractionDigits: 1) } s on the press closes on the same panel again: rows from there on are left out
fit-coefficient-unknown = { $name } is { $verdict }: { $reason }
fit-coefficient-unused = { $run }: its header leaves coefficient '{ $name }' of the press file without use; a campaign needs every coefficient in every run; fit this run separately
fit-fixed = fixed by the press file
fit-gap-at-moment =
    no rows from { NUMBER($begin, minimumFractionDigits: 1, maximumFractionDigits: 1) } s to { NUMBER($end, minimumFractionDigits: 1, maximumFractionDigits: 1) } s, where { $moment ->
        [inserted_s] the insertion
        [closed_s] the closing
       *[opened_s] the opening
    } falls: its moment is estimated within the gap, which makes the coefficients less certain
fit-misfit-astray = residual at rest { NUMBER($rmse, minimumFractionDigits: 1, maximumFractionDigits: 1) } K after the fit, { NUMBER($first, minimumFractionDigits: 1, maximumFractionDigits: 1) } K before it
fit-misfit-lost-insertion = insertion and closing fall into one gap of its rows, { NUMBER($begin, minimumFractionDigits: 1, maximumFractionDigits: 1) } to { NUMBER($end, minimumFractionDigits: 1, maximumFractionDigits: 1) } s
fit-misfit-span = residual at rest { NUMBER($rmse, minimumFractionDigits: 1, maximumFractionDigits: 1) } K, where the readings span { NUMBER($span, maximumFractionDigits: 0) } K
fit-no-run = no run given; name at least one run file
fit-no-such-method = method '{ $method }': must be one of { $methods }
fit-no-such-shared = shared coefficient '{ $name }': must be one of { $names }
fit-not-converged = the search did not converge; the coefficients are where it stopped
fit-not-described = the model does not describe this run: { $misfit }
fit-not-described-check = the model does not describe this run: { $misfit }. Check its header, the press file, and that its rows show insertion and closing
fit-nothing-to-fit = { $run }: nothing to fit: no free coefficient or no usable sensor column
fit-option-averages-alone = { $option } goes with one of the paper's methods; give a method too
fit-option-method-unknown = { $option } { $method }: must be one of { $known }
fit-option-shared-fixed = { $option } { $name }: the press file fixes all coefficients
fit-option-shared-unknown = { $option } { $name }: must be one of { $known }
fit-or-joint = Or take the joint estimate of these { $runs } runs.
fit-or-runs = Or fit it from about { $runs } such runs together.
fit-or-share = Or let all runs share { $name } (--shared { $name }).
fit-outside-allowed = { $name } = { NUMBER($value, maximumSignificantDigits: 4) } W/m²K lies outside what the run allows, { NUMBER($low, maximumSignificantDigits: 4) } to { NUMBER($high, maximumSignificantDigits: 4) }
fit-program = Predicted for { $settings } (95 % of runs):
fit-program-beyond-limit = { $name }: the trend leads to { NUMBER($value, maximumSignificantDigits: 4) } W/m²K, beyond the press file's limit { $limit }, which is taken; run one pressing of this program before relying on it
fit-program-coefficient = {"  "}{ $name } = { NUMBER($value, maximumSignificantDigits: 4) } W/m²K ({ NUMBER($low, maximumSignificantDigits: 4) } to { NUMBER($high, maximumSignificantDigits: 4) })
fit-program-outside = { $name } = { $value } { $unit } lies outside the programs run so far, { NUMBER($low, maximumSignificantDigits: 4) } to { NUMBER($high, maximumSignificantDigits: 4) } { $unit }: the trend is continued; run one pressing there before relying on it
fit-program-remark = Remark: { $remark }
fit-reason = { $role } { $why } { $remedy }
fit-remedy-both-sides = Both faces already carry thermocouples; no reading depends on it.
fit-remedy-calibrate-channels = Calibrate the channels ({ $place }) at two temperatures.
fit-remedy-calibrate-platen = Calibrate the platen channel against the panel channels at one temperature (kerntemp calibrate).
fit-remedy-change = Change the temperatures faster, or further.
fit-remedy-channels = Log the channels that this run lacks too ({ $place }).
fit-remedy-check-channels = Check the channels ({ $place }) against a thermometer before the run (kerntemp calibrate).
fit-remedy-faster = Log faster than the { NUMBER($hertz, maximumSignificantDigits: 2) } Hz of this run.
fit-remedy-faster-and-switch = Log faster than the { NUMBER($hertz, maximumSignificantDigits: 2) } Hz of this run, and log a limit switch as the column closed.
fit-remedy-go-on = Measure at { $boundary } until its temperature has changed more.
fit-remedy-hotter = Repeat the run with a hotter press; a longer open time would not help.
fit-remedy-leave-open = Leave the panel in the open press for a minute before closing instead of { NUMBER($seconds, maximumFractionDigits: 0) } s.
fit-remedy-log-on = Go on logging for a minute after opening instead of { NUMBER($seconds, maximumFractionDigits: 0) } s.
fit-remedy-measure-constant = Measure { $key } on this panel and state how sure it is as { $key }.sd.
fit-remedy-pressing = Log a pressing that closes.
fit-remedy-stay-closed = Keep the press closed for longer than the { NUMBER($seconds, maximumFractionDigits: 0) } s of this run.
fit-remedy-switch = Log a limit switch as the column closed.
fit-remedy-thermocouple = Put a thermocouple on the face of { $layer } towards { $other }.
fit-remedy-thermocouple-free = Put a thermocouple on the outer face of { $layer }.
fit-role-boundary = It acts here: { $boundary }.
fit-role-closed = It couples { $below } and { $above } while the press is closed ({ NUMBER($seconds, maximumFractionDigits: 0) } s in this run).
fit-role-joined = It couples { $below } and { $above }.
fit-role-open = It couples { $below } and { $above } while the press is open ({ NUMBER($before, maximumFractionDigits: 0) } s before closing and { NUMBER($after, maximumFractionDigits: 0) } s after opening in this run).
fit-role-open-face = It acts at the face of { $layer } while the press is open ({ NUMBER($before, maximumFractionDigits: 0) } s before closing and { NUMBER($after, maximumFractionDigits: 0) } s after opening in this run).
fit-shared = one value in all runs, known from all of them together
fit-shared-unknown = one value in all runs, not determined even by all of them together
fit-shortfall-all =
    { $more ->
        [0] The model describes none of these runs: { $runs }. They determine no coefficient; the model keeps the initial values of the press file.
       *[other] The model describes none of these runs: { $runs } and { $more } more. They determine no coefficient; the model keeps the initial values of the press file.
    }
fit-shortfall-one = The model does not describe this run: { $misfit }. It determines no coefficient; the model keeps the initial values of the press file.
fit-shortfall-run = { $run } ({ $misfit })
fit-shortfall-some =
    The model does not describe { $count } of { $total } runs: { $runs }{ $more ->
        [0] .
       *[other] {" "}and { $more } more.
    } { $count ->
        [one] It is left out of all that follows.
       *[other] They are left out of all that follows.
    }
fit-start-before-insertion = header key panel.initial_temperature_C = { $header }, but the panel's channels read { NUMBER($read, minimumFractionDigits: 1, maximumFractionDigits: 1) } °C before the insertion: the coefficients rest on it; correct the header or the channels
fit-start-in-first-row = header key panel.initial_temperature_C = { $header }, but the panel's channels read { NUMBER($read, minimumFractionDigits: 1, maximumFractionDigits: 1) } °C in the first row: the coefficients rest on it; correct the header or the channels
fit-stuck = stuck: the procedure ends { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K rms from the readings; at the guesses it was { NUMBER($first, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, and the default method reaches { NUMBER($own, minimumFractionDigits: 2, maximumFractionDigits: 2) } K
fit-two-sentences = { $first } { $second }
fit-unknown-closing = the moment of closing
fit-unknown-constant = the constant { $place } of the header or press file
fit-unknown-gain = the gain of the channels ({ $place })
fit-unknown-insertion = the moment of insertion
fit-unknown-offset = the offset of the channels ({ $place })
fit-unknown-opening = the moment of opening
fit-unknown-platen-bottom = the error of the lower platen channel
fit-unknown-platen-top = the error of the upper platen channel
fit-unknown-ramp = the time the press takes to close
fit-unknown-skew =
    { $place ->
        [all] the delay of the panel channels
       *[other] the delay of the channels ({ $place })
    }
fit-unknown-start = the panel's start temperature
fit-verdict-fixed = fixed
fit-verdict-identifiable = identifiable
fit-verdict-not-identifiable = not identifiable
fit-verdict-one-sided = bounded on one side only
fit-verdict-shared = shared
fit-why-noise = Its effect of { NUMBER($kelvin, maximumSignificantDigits: 2) } K is lost in the slow noise of the faces ({ NUMBER($noise, maximumSignificantDigits: 2) } K).
fit-why-resistance = Any value above { NUMBER($least, maximumSignificantDigits: 3) } W/m²K fits as well: its resistance, below { NUMBER($resistance, maximumSignificantDigits: 1) } m²K/W, is too small to be seen.
fit-why-together = It is correlated with { $partner } (correlation { NUMBER($correlation, minimumFractionDigits: 2, maximumFractionDigits: 2) }).
fit-why-unseen = No reading of this run moves by more than { NUMBER($kelvin, maximumSignificantDigits: 2) } K when it grows by a factor of 2.7.
fit-why-wide = It is known to a factor of { NUMBER($factor, minimumFractionDigits: 1, maximumFractionDigits: 1) } only.

## softsensor.diagnosis: verdicts, causes, what to measure next

core-largest-shift = In the course of a run it is up to { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K { $change ->
        [hotter] hotter
       *[cooler] cooler
    }.
core-no-panel = There is no panel in this rig, so it has no core.
core-not-proven = Face sensors cannot confirm the core; press a few panels with a core thermocouple.
core-off = Core thermocouples, which took no part in any fit, are { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K off it.
core-press-time = For the core temperature that the plain model predicted, press { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s { $change ->
        [longer] longer
       *[shorter] shorter
    } (median run).
core-shift = { $at ->
        [opening] When the press opens
       *[end] At the end of a run
    }, the core is { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K { $change ->
        [hotter] hotter
       *[cooler] cooler
    } than by the plain model (± { NUMBER($sd, minimumFractionDigits: 1, maximumFractionDigits: 1) } K from run to run).
core-thermocouples = Core thermocouples, which took no part in any fit, are { NUMBER($before, minimumFractionDigits: 1, maximumFractionDigits: 1) } K off the plain model and { NUMBER($after, minimumFractionDigits: 1, maximumFractionDigits: 1) } K off the extended one.
core-unchanged = No cause was added, so the core estimate stays as it is.
diagnosis-no-runs = no runs to diagnose; give at least one run file
diagnosis-verdict-ambiguous = cause narrowed down
diagnosis-verdict-failed = failed
diagnosis-verdict-named = cause named
diagnosis-verdict-no_effect = no effect
diagnosis-verdict-not_described = the model does not describe the runs
diagnosis-verdict-too_few_runs = too few runs
diagnosis-verdict-unknown_effect = unknown effect
gain-hardly = With { $causes ->
        [one] it
       *[other] them
    } the residual hardly changes: from { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } to { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K on runs left out.
gain-more-is-missing = Noise alone is { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, so more is missing that these runs cannot name.
gain-residual-falls = With { $causes ->
        [one] it
       *[other] them
    } the residual falls from { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } to { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K on runs left out.
measured-at = { $at } °C
measured-between = { $low } to { $high } °C
next-confirm-and-core = To know the core, press two or three sacrificial panels with a core thermocouple; to confirm the cause: { $confirm }
next-constants = Measure the panel's conductivity and heat capacity: the faces fit, but core thermocouples are off by { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K, so there is an error that faces do not show.
next-describe = Check thicknesses, materials and columns of press file and runs, then press one panel with a core thermocouple.
next-describe-rig = Check thicknesses, materials and columns of press file and runs, then measure once more with a thermocouple inside a layer.
next-look-there = Press three sacrificial panels with a core thermocouple and look at the times and places listed.
next-look-there-rig = Measure again with a thermocouple at the places and times listed.
next-more-runs = Press at least { $more } more { $more ->
        [one] panel
       *[other] panels
    }, with different press times and, if possible, thicknesses: below { $least } runs a cause cannot be distinguished from chance.
next-more-runs-rig = Measure at least { $more } more { $more ->
        [one] run
       *[other] runs
    } with different courses of temperature: below { $least } runs a cause cannot be distinguished from chance.
next-none = None needed; a core thermocouple in one sacrificial panel a month would confirm the core.
next-none-confirmed = None needed: core thermocouples confirm it ({ NUMBER($before, minimumFractionDigits: 1, maximumFractionDigits: 1) } K off before, { NUMBER($after, minimumFractionDigits: 1, maximumFractionDigits: 1) } K after).
next-none-rig = None needed.
next-tell-apart = To distinguish these causes ({ $causes }): { $confirm }
next-those-runs = Find out how the runs in which more than noise is left differ from the others, and diagnose them by themselves{ $more ->
        [0] .
       *[other] , with { $more } more like them: below { $least } runs a cause cannot be distinguished from chance.
    }
note-cells-jump = { $count } of { $runs } runs: { $cells ->
        [one] a single cell of { $column } jumps by more than { $kelvin } K and was left out
       *[other] { $cells } single cells of { $column } jump by more than { $kelvin } K and were left out
    }
note-channel = { $run }: { $column } is { $kind } ({ NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K rms) and was left out
note-channel-in-runs = { $count } of { $runs } runs: { $column } is { $kind } ({ NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K rms) and was left out
note-left-in-runs = more than noise is left in { $count } of { $runs } runs, { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K there and { NUMBER($rest, minimumFractionDigits: 2, maximumFractionDigits: 2) } K in the others: { $names }
note-refuted-by-cores = core thermocouples rule out { $cause }, although the faces would fit
note-rim-falls = rim sensors fall by { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K against central ones in the course of a run: heat leaves there
note-thickness-alike = panels of { NUMBER($thickness, minimumFractionDigits: 1, maximumFractionDigits: 1) } mm instead of the { NUMBER($given, minimumFractionDigits: 1, maximumFractionDigits: 1) } mm in the headers would show the same: measure one
p-value = p = { NUMBER($p, maximumSignificantDigits: 2) }
p-value-below = p < { NUMBER($p, maximumSignificantDigits: 1) }
p-value-few-runs = { $chance } ({ $runs } { $runs ->
        [one] run
       *[other] runs
    } cannot show less than { NUMBER($least, maximumSignificantDigits: 2) }; named because every left-out run fits better and the remaining residual at least halves)
phase-after-opening = after opening
phase-before-closing = before closing
phase-closed = closed
phase-since-run-began = since the run began
verdict-alike = These runs cannot distinguish the following causes: { $causes }.
verdict-cores-off = The plain model explains the faces of these { $runs } runs to { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, with { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K of noise, yet their core thermocouples are { NUMBER($core, minimumFractionDigits: 1, maximumFractionDigits: 1) } K off it, alike in all runs: something is missing that the faces do not show.
verdict-differs-from-run-to-run = No cause is common to these { $runs } runs, yet the plain model is { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K off and noise alone is { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K: what is missing differs from run to run.
verdict-faulty-channels = Loose, drifting or swapped, and left out: { $columns }.
verdict-few-runs = { $runs } { $runs ->
        [one] run is
       *[other] runs are
    } too few to distinguish a cause from chance.
verdict-few-runs-for-others = { $runs } { $runs ->
        [one] run is
       *[other] runs are
    } too few to distinguish any other cause from chance.
verdict-few-runs-off = { $runs } { $runs ->
        [one] run is
       *[other] runs are
    } too few to distinguish a cause from chance; the plain model is { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K off, of which { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K is noise.
verdict-left = { $who ->
        [some] Some of the runs
       *[all] All runs
    } share a residual that no cause of the catalogue explains.
verdict-left-at = { $who ->
        [some] Some of the runs
       *[all] All runs
    } share a residual that no cause of the catalogue explains: { $stretch }.
verdict-not-described = No verdict is possible: the model is { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K off, and noise alone is { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K. Check the press file, the runs' headers and which column is which.
verdict-panels-differ = The plain model explains these { $runs } runs to { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, with { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K of noise, yet only if their panels differ from one another by more than panels of one product do: something unknown differs from run to run.
verdict-panels-not-as-given = The plain model explains these { $runs } runs to { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, with { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K of noise, yet only if all their panels conduct or store otherwise than the headers give, by more than panels of one product do. Check thickness, density, conductivity and heat capacity.
verdict-plain-model-explains = The plain model explains these { $runs } runs to { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K; noise alone is { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K.
verdict-plain-model-explains-the-rest = Without them, the plain model explains these { $runs } runs to { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K.
verdict-something-beyond-chance = The plain model explains these { $runs } runs to { NUMBER($rmse, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, with { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K of noise, yet with a cause added it fits them better than by chance. That this improves runs left out has not been shown.
verdict-suspected = Suspected, not proven: { $causes }.
where-further = Then: { $stretch }.
where-most = Furthest off: { $stretch }.
where-stretch = measured { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K { $side } the plain model at { $place }, from { $begin } to { $end } s ({ $phase }), where it measured { $temperatures }
where-stretch-to-the-end = measured { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K { $side } the plain model at { $place }, from { $begin } s on ({ $phase }), where it measured { $temperatures }
worth-core = the core is { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K { $change ->
        [hotter] hotter
       *[cooler] cooler
    } { $at ->
        [opening] when the press opens
       *[end] at the end of a run
    }
worth-faulty-channel = found by comparison with the channels beside it, and left out
worth-hardly = hardly lowers the residual on runs left out ({ NUMBER($gain, minimumFractionDigits: 2, maximumFractionDigits: 2) } of { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K); named because { $better } of { $runs } runs, each left out in turn, fit better with it; it { $moved }, and { $core }
worth-hardly-without-panel = hardly lowers the residual on runs left out ({ NUMBER($gain, minimumFractionDigits: 2, maximumFractionDigits: 2) } of { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K); named because { $better } of { $runs } runs, each left out in turn, fit better with it; it { $moved }
worth-moves = { $change } { $coefficient } ({ $bodies }) by { NUMBER($percent, maximumFractionDigits: 0) } %
worth-moves-nothing = moves no coefficient beyond chance
worth-saves = lowers the residual by { NUMBER($gain, minimumFractionDigits: 2, maximumFractionDigits: 2) } K on a typical run left out (geometric mean over the runs)

## softsensor.diagnosis.laws: what is missing as a free function

law-alike = These runs cannot distinguish it from: { $others }.
law-axis-depth_share = height in the panel, as a share of its thickness
law-axis-load_share = pressure, as a share of its reference
law-axis-temperature_C = temperature [°C]
law-axis-time_since_closing_s = time since closing [s]
law-changes = Over the range that the runs cover it { $change ->
        [falls] falls
       *[rises] rises
    } by { NUMBER($percent, maximumFractionDigits: 0) } % between { NUMBER($begin, maximumSignificantDigits: 3) } and { NUMBER($end, maximumSignificantDigits: 3) }.
law-core = { $at ->
        [opening] When the press opens
       *[end] At the end of a run
    }, it has made the core { NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K { $change ->
        [hotter] hotter
       *[cooler] cooler
    }.
law-ends = { $low } = { NUMBER($least, maximumSignificantDigits: 6) } must lie below { $high } = { NUMBER($most, maximumSignificantDigits: 6) }
law-found = Missing, without a name: { $kind }, by { $variable }, from { NUMBER($least, maximumSignificantDigits: 3) } (at { NUMBER($at_least, maximumSignificantDigits: 3) }; 95 %: { NUMBER($least_low, maximumSignificantDigits: 3) } to { NUMBER($least_high, maximumSignificantDigits: 3) }) to { NUMBER($most, maximumSignificantDigits: 3) } (at { NUMBER($at_most, maximumSignificantDigits: 3) }; 95 %: { NUMBER($most_low, maximumSignificantDigits: 3) } to { NUMBER($most_high, maximumSignificantDigits: 3) }){ $unit }; it saves { NUMBER($gain, minimumFractionDigits: 2, maximumFractionDigits: 2) } of { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K on runs left out.
law-heading = What is missing, without a name
law-heat = Between { NUMBER($begin, maximumFractionDigits: 0) } and { NUMBER($end, maximumFractionDigits: 0) } °C heat { $change ->
    [goes] disappears
   *[comes] appears
}, { NUMBER($amount, maximumSignificantDigits: 2) } kJ/kg of panel (95 %: { NUMBER($least, maximumSignificantDigits: 2) } to { NUMBER($most, maximumSignificantDigits: 2) }){ $change ->
    [goes] : evaporation or a phase change would do this.
   *[comes] : a reaction would do this.
}
law-kind-conductivity = factor on the conductivity of the panel
law-kind-contact = factor on the closed contacts of the panel
law-kind-contact_by_load = factor on the panel's closed contacts as the pressure changes
law-kind-contact_by_temperature = factor on the panel's closed contacts as its faces warm up
law-kind-contact_lower = factor on the closed contact of the lower face
law-kind-contact_upper = factor on the closed contact of the upper face
law-kind-heat = heat consumed as the panel warms up, not returned on cooling
law-kind-heat_exchange = heat lost to the room per volume
law-kind-source_by_depth = heat released in the panel while the press is closed
law-kind-source_by_time = heat released everywhere in the panel since the press closed
law-lacks = { $name } is missing, and all numbers of a law belong together; take them from the file that diagnose wrote
law-none = No free law: none is sure to improve runs left out.
law-resembles = Within its band it agrees with the curve of a known cause: { $cause }.
law-variable-depth_share = height in the panel (0 below, 1 above)
law-variable-load_share = pressure as a share of its reference
law-variable-temperature_C = temperature in °C
law-variable-time_since_closing_s = time since closing in s

## softsensor.diagnosis.rehearsal: error rates of a campaign

rehearsal-alone = named alone
rehearsal-begins = Rehearsal of { $runs } runs: { $campaigns } simulated campaigns to diagnose, { $done } done before. They come from the sensor's own model with these runs' programs, noise and scatter.
rehearsal-count = { $name } = { $value }: give a whole number of at least 1
rehearsal-counted = { $count } of { $of }
rehearsal-file-other = { $path }: holds something else than finished campaigns of a rehearsal; give a new file, or the one of an earlier rehearsal
rehearsal-found = found
rehearsal-heading = How often such a diagnosis is right
rehearsal-lost = { $count ->
    [one] { $count } of the campaigns is missing and counts
   *[other] { $count } of the campaigns are missing and count
} nowhere: the processes that simulated them were killed.
rehearsal-none = With nothing hidden, a cause is named in { $rate } of the campaigns.
rehearsal-not-testable = { $name }: these runs cannot show it; choose from { $known }
rehearsal-options-alone = --rehearse-campaigns, --rehearse-effect, --rehearse-file and --dask go with --rehearse; give it too
rehearsal-own-model = The campaigns are simulated by the sensor's own model: rates are those of a press that it describes but for the one cause. What a real press does besides makes them worse.
rehearsal-rate = { $count } of { $of } ({ NUMBER($low, maximumFractionDigits: 0) } to { NUMBER($high, maximumFractionDigits: 0) } %)
rehearsal-size = { $name }={ $size }: the size must be a number from { $low } to { $high }
rehearsal-size-cell = { $value } { $unit }
rehearsal-size-head = size
rehearsal-size-none = { $name }={ $size }: of this size it is absent; campaigns with nothing hidden are rehearsed anyway
rehearsal-takes = This takes about { NUMBER($minutes, maximumFractionDigits: 0) } min on { $workers } { $workers ->
    [one] process
   *[other] processes
}.
rehearsal-title = Campaigns of { $runs } runs such as these, each with one cause hidden: how many of them find it, with 95 % intervals.
rehearsal-wrong = another cause named

## softsensor.planning: the next pressings

advise-assumed = Assumed: platens stand at their set point; what they lose outwards is not counted. The live sensor decides when to open.
advise-best = Press for { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s at { NUMBER($platen, maximumFractionDigits: 0) } °C: all limits hold with a probability of { NUMBER($percent, maximumFractionDigits: 1) } %
advise-cure-without-resin = a limit of cure needs the resin's kinetics; give a resin file too
advise-energy = { NUMBER($energy, maximumFractionDigits: 3) } kWh a panel, { NUMBER($panels, maximumFractionDigits: 0) } panels an hour
advise-energy-cost = { $energy }, { NUMBER($cents, maximumFractionDigits: 1) } cents a panel
advise-goal-unknown = goal { $goal }: must be one of { $known }
advise-limit-core_least = core too cold
advise-limit-core_most = core too hot
advise-limit-cure_bottom = lower face undercured
advise-limit-cure_top = upper face undercured
advise-limit-steam_most = too much steam
advise-load-unit = press { $press }: the model follows the load in column { $column }, whose unit is not given: add unit = "N/cm2", "kPa", "bar" or "MPa" to the contact's load
advise-margin = The median panel is ready after { NUMBER($likely, minimumFractionDigits: 1, maximumFractionDigits: 1) } s; up to { NUMBER($until, maximumFractionDigits: 0) } s all limits hold with the wanted probability.
advise-measure = If this were known exactly, { NUMBER($seconds, minimumFractionDigits: 1, maximumFractionDigits: 1) } s would do: { $source }
advise-no-limit = no limit is given; give a resin file with [limits], or the least or the most that the core is to reach
advise-none = No program within the ranges keeps all limits. Closest: platens { NUMBER($platen, maximumFractionDigits: 0) } °C, a limit broken with a probability of { NUMBER($percent, maximumFractionDigits: 0) } %, most likely: { $limit }
advise-panel = Panel: { $material }, { $thickness } mm
advise-panel-unreadable = --panel '{ $given }': must be KEY=VALUE, such as panel.thickness_mm=16
advise-press-time-narrow = range of press_time_s from { NUMBER($low, maximumFractionDigits: 3) } to { NUMBER($high, maximumFractionDigits: 3) }: press times are tried in steps of { NUMBER($step) } s, and none lies in the range; widen it
advise-press-without-states = { $press }: nothing in the press file opens and closes, so there is no press time
advise-pressure = Pressure: { NUMBER($pressure, maximumFractionDigits: 0) } N/cm²
advise-pressure-unknown = range of { $name }: the model does not know what pressure does, as nothing in it follows a load; leave it out, or diagnose runs of different pressures first
advise-source-coefficients = the contacts of this pressing (the live sensor learns them while it presses; even contacts help)
advise-source-effects = the size of the diagnosed causes (more runs)
advise-source-kinetics = the resin's kinetics (a DSC of this paper)
advise-source-platens = the platens' true temperature (calibrate them)
advise-source-sorption = the board's isotherm (a sorption test)
advise-steam-without-moisture = a limit of steam needs the panel's moisture; add { $key } to the panel, or take steam_most_kPa out of the limits
plan-best = Best: { $settings }. { $prospect }
plan-best-is-usual = Best: the usual settings. { $prospect }
plan-heading = The next pressings worth most
plan-narrows-factor = One brings it to a factor of { NUMBER($factor, maximumFractionDigits: 2) }; { $runs }.
plan-narrows-kelvin = One brings it to ±{ NUMBER($kelvin, maximumFractionDigits: 2) } K; { $runs }.
plan-not-described = The model does not describe these runs, so what a further pressing would bring cannot be forecast.
plan-nothing-open = No question is left that a pressing could settle.
plan-open-causes = Not distinguished: { $causes }
plan-open-coefficient = { $name } is known to within a factor of { NUMBER($factor, maximumFractionDigits: 2) } either way (wanted: { NUMBER($wanted, maximumFractionDigits: 2) })
plan-open-core = The core at the opening is known to ±{ NUMBER($kelvin, maximumFractionDigits: 1) } K for what all pressings share (wanted: ±{ NUMBER($wanted, maximumFractionDigits: 1) } K)
plan-open-suspected = Suspected, not proven: { $causes }
plan-range-unknown = range of { $name }: no such setting here; known are { $known }
plan-range-unreadable = --range '{ $given }': must be NAME=LOW:HIGH, such as thickness_mm=8:19
plan-range-wrong = range of { $name } from { NUMBER($low, maximumFractionDigits: 3) } to { NUMBER($high, maximumFractionDigits: 3) }: give the lower end first; both must lie between { NUMBER($lower, maximumFractionDigits: 3) } and { NUMBER($upper, maximumFractionDigits: 3) }
plan-repeated = Repeating the usual settings: { $prospect }
plan-runs = { $runs ->
    [one] { $runs } is enough
   *[other] { $runs } are enough
}
plan-runs-too-many = even { $many } are not enough
plan-set-as-usual = the usual settings
plan-set-platen_temperature_C = platens { NUMBER($value, maximumFractionDigits: 0) } °C
plan-set-press_time_s = press time { NUMBER($value, maximumFractionDigits: 0) } s
plan-set-pressure_N_cm2 = pressure { NUMBER($value, maximumFractionDigits: 0) } N/cm²
plan-set-start_temperature_C = panel at { NUMBER($value, maximumFractionDigits: 0) } °C
plan-set-thickness_mm = panel of { NUMBER($value, maximumFractionDigits: 1) } mm
plan-set-waiting_s = { NUMBER($value, maximumFractionDigits: 0) } s open before closing
plan-setting-unknown = { $name }: this run has no such setting; it has { $known }
plan-setting-wrong = { $name } = { $value } must lie between { $lower } and { $upper }
plan-settles = One settles it with a chance of { NUMBER($percent, maximumFractionDigits: 0) } %; { $runs }.
plan-settles-surely = One settles it almost certainly: the chance is above 99 %.
plan-until-of-diagnosis = until: a diagnosis has its runs already; give until to diagnose, or the runs themselves to plan
plan-with-core = With a thermocouple in the core: { $settings }. { $prospect }
what-if-too-long = a run of more than { NUMBER($most, maximumFractionDigits: 0) } s is not simulated; give a shorter press time

## softsensor.live: why the core is not valid

blisters-bear = Half of the panels withstand { NUMBER($most, maximumFractionDigits: 0) } kPa of steam (95 %: { NUMBER($low, maximumFractionDigits: 0) } to { NUMBER($high, maximumFractionDigits: 0) }).
blisters-foreseen = Later panels, each forecast from those marked before it: what became of them had a mean probability of { NUMBER($learned, maximumFractionDigits: 0) } %, by the stated limit { NUMBER($stated, maximumFractionDigits: 0) } %.
blisters-keep = Store these two as well, so that the same panels are not counted twice: steam_believed_kPa = { NUMBER($believed, maximumFractionDigits: 2) }, steam_believed_kPa.sd = { NUMBER($sd, maximumFractionDigits: 2) }
blisters-marks = { $marks ->
        [one] One marked panel
       *[other] { $marks } marked panels
    } whose steam at opening is known, { $blistered } blistered.
blisters-write = For [limits] of the resin file: steam_most_kPa = { NUMBER($most, maximumFractionDigits: 0) }, steam_most_kPa.sd = { NUMBER($sd, maximumFractionDigits: 0) }
core-may-pass-limit-soon = the core may pass { NUMBER($limit_C, maximumFractionDigits: 1) } °C in { NUMBER($seconds, maximumFractionDigits: 0) } s: open the press
core-will-pass-limit = the core will peak at { NUMBER($peak_C, maximumFractionDigits: 0) } °C, above the limit of { NUMBER($limit_C, maximumFractionDigits: 1) } °C
core-will-pass-limit-even-if-opened = the core will peak at { NUMBER($peak_C, maximumFractionDigits: 0) } °C even if the press is opened now, above the limit of { NUMBER($limit_C, maximumFractionDigits: 1) } °C
reason-another-panel = panel thickness in doubt: { NUMBER($header_mm, maximumFractionDigits: 1) } mm in the header, { NUMBER($nearest_mm, maximumFractionDigits: 1) } mm in the nearest earlier run of this press; the band over both is wider than ±{ NUMBER($limit_K, maximumFractionDigits: 0) } K; check the thickness in the header
reason-band-too-wide = core not observable: the band is wider than ±{ NUMBER($limit_K, maximumFractionDigits: 0) } K
reason-calculation-failed = the calculation failed and is being restarted
reason-clock-ahead = the readings are stamped { NUMBER($ahead_s, maximumFractionDigits: 0) } s ahead of this computer's clock: set the clocks
reason-constants-far-from-the-material = the panel's constants are known to no better than 50 %: the header's are far from those of its material, or the last runs had them far from the header's; correct them, or state how sure they are (KEY.sd)
reason-core-impossible = the calculated core is at { NUMBER($core_C, maximumFractionDigits: 0) } °C, which is impossible: nothing colder than { NUMBER($lowest_C, maximumFractionDigits: 0) } °C or hotter than { NUMBER($highest_C, maximumFractionDigits: 0) } °C has touched the panel
reason-estimate-behind-the-press = the press has just moved, and the live sensor has yet to follow
reason-faces-jumped-during-a-gap = both faces jumped in temperature during a gap in the readings
reason-faces-too-cold-for-this-panel = the faces are far colder than those of the panel that was pressed; another panel may lie there
reason-insertion-not-seen = core not observable: nothing has shown when the panel was inserted
reason-live-sensor-silent = the live sensor has given no estimate for { SPAN($silent_s) }
reason-no-estimate-yet = the live sensor has given no estimate yet
reason-no-panel-in-the-press = no panel in the press
reason-no-reading-of-the-lower-face = core not observable: no sensor of the lower face shows whether a panel lies in the press
reason-no-scans = no scan for { SPAN($silent_s) }
reason-not-published = nobody publishes it at the moment
reason-panel-not-seen-in-the-open-press = for a long time no sensor has shown whether the panel still lies in the open press
reason-platen-reading-missing = platen reading missing
reason-platen-reading-missing-at-insertion = the platen readings were missing when the panel was inserted
reason-press-closed-again-on-the-same-panel = the press has closed again on the same panel
reason-press-closed-during-a-gap = the press closed during a long gap in the readings
reason-press-state-unknown = press state unknown
reason-readings-contradict-the-model = the panel's sensors contradict the model
reason-run-begins-in-the-closed-press = the run begins in the closed press
reason-run-begins-with-the-panel-on-the-hot-plate = the run begins with the panel on the hot plate
reason-run-refused = the run cannot be followed: { $problem }
reason-start-not-read = core not observable: the start is taken from the first readings, and there is none yet
reason-start-temperature-contradicted = sensors read { NUMBER($measured_C, maximumFractionDigits: 0) } °C, but the header gives a start temperature of { NUMBER($header_C, maximumFractionDigits: 0) } °C
reason-start-temperature-too-high = the header gives a start temperature of { NUMBER($header_C, maximumFractionDigits: 0) } °C; no fresh panel is so hot
reason-store-away = the store does not answer
resin-is-example = the resin "{ $name }" is an example; measure the paper at hand and put its own kinetics into the resin file
resin-needs-panel = the press has no panel, so no paper cures; leave the resin out
resin-no-limits = the resin file has no limit in [limits], so open_now stays 0; set cure_least
resin-no-moisture = { $key } is missing or 0 in the header, so steam is not known and open_now stays 0; add it, or take steam_most_kPa out of the resin file
resin-not-verified = the numbers of the resin "{ $name }" have not been compared with their source; compare them, then set verified = true in the resin file
steam-limit-no-marks = { $runs ->
        [one] for the one run marked good or blister the steam at opening is not known
       *[other] for none of { $runs } runs marked good or blister is the steam at opening known
    }; mark panels ({ $key }), and give panel.moisture_percent

## softsensor.jobs: services and nights

coefficient-has-changed = { $coefficient } has changed since run { $run } (noticed at { $noticed }): it is { NUMBER($percent, maximumFractionDigits: 0) } % of what it was; look at what was done to the press before it
dask-no-answer = Dask scheduler { $address }: no answer in { $seconds } s; check [refit] dask and that it runs
dask-no-worker = Dask scheduler { $address }: no worker in { $seconds } s; start dask worker { $address }
dask-package-missing = Dask scheduler { $address }: the package 'distributed' is missing; on a press PC kerntemp_setup.py complete brings it, elsewhere pip install 'kerntemp[dask]'
dask-scheduler-lost = Dask scheduler { $address } went away over the work; see that it runs, then start again
dask-workers-lost = Dask scheduler { $address } has had no worker for { SPAN($seconds) }; start dask worker { $address }
model-none-before = press { $press }: no earlier model to go back to
night-against-core-silenced = the core is valid in fewer scans
night-against-core-worse = the core gets worse
night-against-not-significant = the gain is not significant
night-against-predicts-worse = it predicts runs worse
night-against-still-helps = an effect it would drop still improves the fit
night-archive = { $press }: { $archived ->
        [one] one run
       *[other] { $archived } runs
    } moved into the archive ({ NUMBER($freed, minimumFractionDigits: 1, maximumFractionDigits: 1) } MB to { NUMBER($written, minimumFractionDigits: 1, maximumFractionDigits: 1) } MB){ $removed ->
        [0] { "" }
       *[other] , scans of { $removed } deleted
    }{ $later ->
        [0] { "" }
       *[other] , { $later } follow in the next nights
    }
night-at-work-already = another nightly job works on press { $press } in { $store }: let that one come to its end
night-compared =
    { $kind ->
        [with] { $effects }
        [without] no longer: { $without }
       *[both] { $effects }; no longer: { $without }
    }: residual of single sensors{ $still ->
        [yes] { " at rest" }
       *[no] { "" }
    }, own contacts fitted, from { NUMBER($before, minimumFractionDigits: 3, maximumFractionDigits: 3) } to { NUMBER($after, minimumFractionDigits: 3, maximumFractionDigits: 3) } K on { $apart ->
        [yes] { $runs } runs that took no part
       *[no] { $runs } runs of the diagnosis
    }{ $predicted }{ $core }{ $against }
night-compared-against = { "; " }{ $what }
night-compared-core = { ", " }core from { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } to { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K live
night-compared-predicted = { ", " }predictions from { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } to { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K off
night-diagnosis-confirms = the diagnosis confirms it
night-failed = { $press }: the nightly job failed: { $why }
night-first-model = first model, coefficients of { $runs } runs
night-first-model-although = first model, coefficients of { $runs } runs; { $although }
night-fits =
    { $fitted } of { $runs } runs fitted, { $kept ->
        [0] { "" }
        [one] 1 keeps its fit,{ " " }
       *[other] { $kept } keep their fits,{ " " }
    }{ $failed } could not be fitted{ $blind ->
        [0] { "" }
        [one] , { $blind } has no panel sensors
       *[other] , { $blind } have no panel sensors
    }
night-fits-later = { $fits }, { $later } older ones follow in { $nights ->
        [one] the next night
       *[other] the next { $nights } nights
    }
night-left-to-you = { $version } is not promoted automatically; decide on it yourself: { $reason }
night-like-rolled-back = { $reason }; like { $version }, which was rolled back
night-not-sure-yet = only suspected, since all nights together do not yet prove that anything is missing: { $causes }
night-nothing-changed = nothing changed
night-outcome =
    { $press }: { $fits }; diagnosis: { $verdict ->
        [not_asked] not asked
        [no_effect] no effect
        [named] cause named
        [ambiguous] cause narrowed down
        [unknown_effect] unknown effect
        [too_few_runs] too few runs
        [not_described] the model does not describe the runs
       *[other] see its report
    }; { $model ->
        [promoted] model { $version } promoted
        [stays] model { $version } stays
       *[none] no model yet
    }: { $reason }
night-rejected = { $version } rejected: { $reason }
night-too-few-runs = { $runs ->
        [one] one run
       *[other] { $runs } runs
    } fitted, { $needed } are needed
night-too-few-to-judge = too few runs to judge by
night-without-sisters = { $press }: it begins without what presses of the same kind have learned: { $why }
night-workers-killed = { $press }: the workers that worked on its night were killed; the nightly job works on it itself, run by run
night-workers-lost = the workers were lost: { $why }; the nightly job works on the presses that are left itself
press-problem = { $press }: { $problem }
run-fit-again = run { $run }: its worker process was killed or stopped responding; another one is fitting it; memory may be short
run-fit-killed = run { $run } could not be fitted: its worker process was killed or stopped responding, twice; memory may be short
run-not-fitted = run { $run } could not be fitted: { $why }
run-not-judged = run { $run } was left out of the night's judgement: { $why }
run-nothing-to-fit = run { $run } has no panel sensors: nothing to fit
sense-compiling = compiling the model, once after an installation or an update: about a minute
sense-following = following { $presses }
sense-follows-run = following run { $run }
sense-model-not-taken = the live sensor cannot take the model in force and goes on with { $version }: { $why }
sense-resin-not-taken = the resin file as it stands cannot be read, so its last readable content still decides on cure, steam and leave to open: { $why }
sense-takes-model = the live sensor takes model { $version }
sense-waiting = waiting for scans

## softsensor.report: figures

figure-adaptive = adaptive solver
figure-advice-any = any limit, platens at { NUMBER($platen, maximumFractionDigits: 0) } °C
figure-advice-others = any limit, platens at { NUMBER($low, maximumFractionDigits: 0) } to { NUMBER($high, maximumFractionDigits: 0) } °C
figure-advice-press-time = press time [s]
figure-advice-risk = chance that a limit is broken [%]
figure-blister-chance = chance of a blister [%]
figure-channels = all sensors
figure-coefficient = { $name } = { NUMBER($mean, maximumSignificantDigits: 4) } W/m²K
figure-coefficient-shared = { $name } = { NUMBER($mean, maximumSignificantDigits: 4) } W/m²K, shared
figure-coefficient-spread = { $name } = { NUMBER($mean, maximumSignificantDigits: 4) } ± { NUMBER($sd, maximumSignificantDigits: 2) } W/m²K
figure-coefficient-unknown = { $name } [W/m²K] is not known
figure-core = core, { $model }
figure-core-band = its 95 % band
figure-core-by-fit = core by the fitted model
figure-core-fitted = { $run }: core known to ± { NUMBER($half, minimumFractionDigits: 1, maximumFractionDigits: 1) } K (95 %) at worst
figure-core-fitted-measured = { $run }: core known to ± { NUMBER($half, minimumFractionDigits: 1, maximumFractionDigits: 1) } K (95 %) at worst; its thermocouples are { NUMBER($error, minimumFractionDigits: 1, maximumFractionDigits: 1) } K rms off
figure-core-live = Core as predicted live, with its 95 % band
figure-core-measured = core, measured
figure-correlation = correlation
figure-cost = cost per reading above its minimum
figure-dots-and-lines = dots: measured, lines: simulated
figure-exact = exact solver
figure-extended = extended
figure-fit = { $run }: the fitted model is { NUMBER($fit, minimumFractionDigits: 2, maximumFractionDigits: 2) } K rms off the sensors ({ NUMBER($guesses, minimumFractionDigits: 1, maximumFractionDigits: 1) } K with the press file's guesses)
figure-from-best = { $name } from its best value [%]
figure-known-from-run = Known from { $run }: { $known }
figure-known-from-runs = { $runs } runs: { $known } known from every run; spread from run to run up to { NUMBER($percent, maximumFractionDigits: 0) } %
figure-largest = { $sign }{ NUMBER($kelvin, minimumFractionDigits: 1, maximumFractionDigits: 1) } K at { NUMBER($at, minimumFractionDigits: 1, maximumFractionDigits: 1) } s
figure-mean = measured (mean)
figure-measured = measured
figure-measured-mean = measured, mean of { $channels } sensors ± their scatter
figure-measured-minus-model = measured − model [K]
figure-misfit-saved = misfit reduction [σ²]
figure-model = { $model } model
figure-moves-with = { $run }: { $one } is most strongly correlated with { $other } ({ $sign }{ NUMBER($size, minimumFractionDigits: 2, maximumFractionDigits: 2) })
figure-normalised = Relative to the mean: { $name } differs most from run to run ({ NUMBER($percent, maximumFractionDigits: 0) } %)
figure-not-described = { $run }: the model does not describe this run, it is { NUMBER($fit, minimumFractionDigits: 2, maximumFractionDigits: 2) } K rms off ({ NUMBER($guesses, minimumFractionDigits: 1, maximumFractionDigits: 1) } K with the press file's guesses)
figure-nothing-known = No coefficient is known: the model does not describe what was measured
figure-over-mean = value / mean
figure-plain = plain
figure-plan-best = best settings
figure-plan-repeated = usual settings
figure-plan-with-core = the same with a core thermocouple
figure-rehearsal-nothing = nothing hidden
figure-rehearsal-share = share of the campaigns [%]
figure-residuals = What all runs have in common is what the model lacks
figure-roughness = Adaptive steps make the cost rough: differences measure the steps, not the slope
figure-run = run
figure-since-beginning = time since the beginning [s]
figure-since-closing = time since closing [s]
figure-steam = steam at opening [kPa]
figure-temperature = temperature [°C]
figure-time = time [s]
figure-votes = { $better } of { $runs } runs, each left out in turn, fit better with this cause: { $cause }
figure-with-fit = model with fitted coefficients
figure-with-guesses = model with the press file's guesses
figure-worst-run = { $run }, the worst fit of all runs: the plain model is { NUMBER($rms, minimumFractionDigits: 2, maximumFractionDigits: 2) } K off (rms of place means)
figure-worst-run-extended = { $run }: { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K off with the plain model, { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K with { $causes }
figure-worth = worth of one pressing [nats]
figure-worth-of-pressing = What one pressing is worth, by open point

## softsensor.report: nights

night-back = Back to the version before:
night-cannot-write = { $path }: cannot write the report: { $why }; see [refit] reports
night-diagnosis = Diagnosis
night-drift = { $coefficient }: { $what }
night-drifts = Drift
night-effects = effects
night-fitted-with = fitted with
night-in-force = Model in force
night-no-diagnosis = None yet.
night-no-drift = No coefficient has shown a drift.
night-no-effects = none
night-no-model = There is no model yet: { $reason }.
night-not-fitted = not fitted
night-parameters = parameter
night-promoted = Model { $version } was promoted: { $reason }.
night-residual = surface residual
night-run-not-described = { $rmse }, not described by the model
night-runs = Newest runs
night-spread = a run may differ by
night-started = started
night-status = status
night-status-candidate = candidate
night-status-promoted = promoted
night-status-rejected = rejected
night-status-retired = retired
night-stays = Model { $version } stays in force: { $reason }.
night-title = Nightly refit of press “{ $press }”
night-unit = unit
night-verdict = Verdict:
night-version = version
night-versions = Versions
night-warnings = Warnings in the journal
night-why = why
night-with-guesses = with the press file's guesses
night-with-press-file = press file

## softsensor.report: reports of fits and diagnoses

kelvin-off = { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K
kelvin-signed = { $sign }{ NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K
known-all = all coefficients
known-none = none of the coefficients
paper-adaptive = adaptive
paper-boundary-not-measured = { $boundary } is { $kind }; the paper's solver takes measured boundaries alone: compare runs of a press whose boundaries are columns
paper-exact = exact
paper-exact-sensitivities = exact
paper-finite-differences = finite differences
paper-no-measurement = there is no measurement; give at least one
paper-none-judged = judged = { $judged }: none of them is fitted here ({ $known }); name at least one of these
paper-slope-changes = Cost along { $name } within ±{ NUMBER($span, maximumSignificantDigits: 1) } %: the slope changes sign { $adaptive ->
    [one] once
   *[other] { $adaptive } times
} with the adaptive solver, { $exact ->
    [one] once
   *[other] { $exact } times
} with the exact one.
paper-truth-missing = the true value of { $names } is missing; give one for each coefficient that is not fixed
report-95-bootstrap = 95 % (bootstrap)
report-95-of-mean = 95 % of the mean (t)
report-95-of-runs = 95 % of its runs
report-at-core = At the core: { $core }
report-bold-better = W/m²K, ± half the 95 % interval. Bold: much better known together than alone.
report-bold-excludes = Bold: the 95 % interval excludes no change.
report-candidates = All candidates
report-cause = cause
report-causes-alike = These runs cannot distinguish the causes. What can:
report-chance = chance that luck alone would do as well
report-change = change of the coefficient
report-coefficient = coefficient
report-coefficients = { $runs ->
        [0] Coefficients
        [one] Coefficients
       *[other] Over the campaign
    }
report-cost = What it costs
report-count-of = { $count } of { $total }
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
report-dependence = Dependence on the press program
report-diagnosis-basis = Press “{ $press }”, { $runs } { $runs ->
        [one] run
       *[other] runs
    }
report-diagnosis-of = { $verdict } – press { $press }
report-error-core = error of the core at core thermocouples, panels as their headers give them
report-error-core-predicted = error at core thermocouples, runs predicted
report-every-run = Every run by itself
report-every-run-joint = Every run with what it borrows from the others
report-extended-model = extended model
report-fit-of = Heat transfer coefficients of press “{ $press }”
report-fitted = Fitted to { $runs ->
        [one] one run
       *[other] { $runs } runs
    }, the model is { NUMBER($fit, minimumFractionDigits: 2, maximumFractionDigits: 2) } K off the sensors ({ $runs ->
        [one] { "" }
       *[other] median;{ " " }
    }{ NUMBER($guesses, minimumFractionDigits: 1, maximumFractionDigits: 1) } K with the press file's guesses).
report-from-on = { $begin } s to the end
report-from-to = { $begin } s – { $end } s
report-gain = What is gained
report-how = How this was found
report-how-averages = The values of single runs come from the paper's procedure, { $method } on averages of the upper and lower sensors; moments, verdicts and the joint estimates from Kerntemp's own method:
report-how-channels = The values of single runs come from the paper's procedure, { $method } on every sensor with its own offset; moments, verdicts and the joint estimates from Kerntemp's own method:
report-how-fitted = Levenberg–Marquardt in the logarithm of the coefficients. Closing, opening and the closing ramp, the start temperature, platen and sensor errors are adjusted within what a measuring chain may be wrong by, and widen the intervals. Residuals are treated as correlated in time, their level estimated from each run. Whether a coefficient is identifiable is read from the profile of the likelihood of that run.
report-how-model = Layered heat conduction with a contact coefficient between neighbours for each press state, solved implicitly with exact sensitivities.
report-hundredths = { NUMBER($value, minimumFractionDigits: 2, maximumFractionDigits: 2) }
report-joint-median = joint median
report-known = { $runs ->
        [one] Known from it
       *[other] Known from these runs
    }: { $known }.
report-known-to = { NUMBER($value, maximumSignificantDigits: 4) } ± { NUMBER($percent, maximumFractionDigits: 0) } %
report-legend-coefficients = Dots: single runs with 95 % intervals. Line and band: mean and σ. Cross: a run in which the coefficient is not identifiable, drawn at the mean of those in which it is; where it is in none, nothing is drawn.
report-legend-core = Core: the middle of the panel by the fitted model. Its band is what coefficients, moments, measuring chain and the panel's constants leave open (95 %), as far as the model itself holds. Core thermocouples take no part in the fit.
report-legend-every-run = W/m²K, ± half the 95 % interval. Italics: not identifiable in that run; the interval that the data leave open. Not described: the model does not fit the run, so nothing is read from it.
report-legend-measured = Error bars: standard deviation over the sensors of a face. Grey dashes: the model with the press file's guesses. Shaded: press closed. Residuals without each face's constant offset, their band the scatter of the face's sensors; where the press moves they are off the scale, and the largest is noted.
report-legend-normalised = Dots: single runs over the mean, in their order. Bars: ± σ.
report-legend-profile = A profile shows how much worse the model fits the run the further a coefficient is moved while all other unknowns follow; where it stays below the line the value fits as well (95 %). A profile that does not cross the line on a side is open there.
report-legend-run = Dots: mean of the readings; tinted about them: from the lowest to the highest sensor. Grey: the plain model with this run's own coefficients. Orange: with the cause added. Dashed: core, of the panel as its header gives it. Shaded: press closed; below, where the plain model is most kelvins off, and what was measured there.
report-mean = mean
report-mean-note = Mean and σ over the runs in which the coefficient is identifiable. Joint median and true spread: all runs estimated together as draws from one log-normal population, the error of each single estimate taken out.
report-measured-against-simulated = Measured against simulated
report-measured-minus-plain = measured − plain model
report-measured-there = measured there
report-method-least_squares = gradient least squares
report-method-nelder_mead = Nelder-Mead
report-method-nelder_mead_then_least_squares = Nelder-Mead followed by weighted least squares
report-misfit-saved = misfit reduction, in variances of the noise
report-next = Measure next
report-no-cause = No cause of the catalogue was named.
report-no-core = no core thermocouple
report-noise-alone = Noise of the sensors alone: { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K. Surfaces can fit while the core is wrong: only core thermocouples prove the core.
report-not-converged = not converged
report-not-described = not described
report-not-known = { $runs ->
        [one] Not known
       *[other] Not from every run
    }: { $names }.
report-not-varied = not varied
report-notes = Notes
report-notes-on-runs = Notes on single runs
report-number = { NUMBER($value, maximumSignificantDigits: 4) }
report-number-2 = { NUMBER($value, maximumSignificantDigits: 2) }
report-number-3 = { NUMBER($value, maximumSignificantDigits: 3) }
report-paper = Why gradient least squares got stuck, and why it need not
report-paper-converged = converged
report-paper-error = error against the truth
report-paper-note = Adaptive: LSODA at scipy's default tolerances on the same mesh; its exact sensitivities are integrated beside the temperatures by the same solver. Converged: the lowest cost any of the four found, within 2 %. Error: median over the measurements of the largest error among the coefficients every run shows. That the paper's trouble had this cause is a hypothesis; that this cause is enough for it is what the table shows.
report-paper-slopes = slopes
report-paper-solver = solver
report-paper-solves = solves
report-paper-time = time a measurement [s]
report-paper-what = The same virtual measurements, the same starts (off by up to a factor of 3), the same optimiser at its defaults; only the solver and the way to get slopes differ.
report-per-10-degrees = per 10 °C platen temperature
report-per-10-newton = per 10 N/cm² pressure
report-per-10-seconds = per 10 s press time
report-percent = { NUMBER($percent, minimumFractionDigits: 1, maximumFractionDigits: 1) } %
report-place = place
report-plain-model = plain model
report-plan = What to press next
report-predicted = predicted
report-preferred = The runs prefer it to { $cause } by { NUMBER($t, maximumFractionDigits: 1) } standard errors.
report-prior = { $name }: { NUMBER($median, maximumSignificantDigits: 6) } W/m²K, times or over { NUMBER($factor, maximumSignificantDigits: 6) }.
report-priors-note = Priors from the press file:
report-profile-of = profile of { $name }
report-profiles = Profiles and correlations of every run
report-program = A program never run
report-program-of = Predicted for { $settings } (95 % of runs)
report-residual-fitted = residual of all sensors, fitted runs
report-residual-kelvin = rmse [K]
report-residual-left-out = residual on runs left out, own contacts fitted, root mean square of all runs
report-residual-predicted = residual on runs predicted from header and other runs alone, root mean square of all runs
report-run = run
report-run-not-described = { $runs ->
        [one] The run that the model does not describe
       *[other] The worst of the runs that the model does not describe
    }
report-runs = runs
report-runs-that-know-it = runs that know it
report-saved-left-out = saved on a typical run left out
report-setting = { $name } = { $value } { $unit }
report-shared = shared
report-shared-note = One value was asked for in all runs: { $names }.
report-signed = { $sign }{ NUMBER($value, minimumFractionDigits: 2, maximumFractionDigits: 2) }
report-since-state-began = since it began
report-slope = { NUMBER($percent, minimumFractionDigits: 1, maximumFractionDigits: 1) } % ({ NUMBER($low, minimumFractionDigits: 1, maximumFractionDigits: 1) } … { NUMBER($high, minimumFractionDigits: 1, maximumFractionDigits: 1) })
report-span = { NUMBER($low, maximumSignificantDigits: 4) } – { NUMBER($high, maximumSignificantDigits: 4) }
report-span-3 = { NUMBER($low, maximumSignificantDigits: 3) } – { NUMBER($high, maximumSignificantDigits: 3) }
report-state = state
report-symptom = Symptom: { $symptom }
report-tenths = { NUMBER($value, minimumFractionDigits: 1, maximumFractionDigits: 1) }
report-true-spread = true spread
report-typical-run = { $runs ->
        [one] The run
       *[other] A typical run
    }
report-unknown = What these runs cannot determine, and which measurement would
report-value = value
report-what-is-wrong = What is wrong
report-why = Why
report-why-and-remedy = why, and which measurement fixes it
report-with-guesses-kelvin = with guesses [K]
report-worst-run = The run with the worst fit
report-worth = explains { NUMBER($percent, maximumFractionDigits: 0) } % of what the runs have in common and { $worth }. The chance that luck alone would do as well, by flipping signs of whole runs or by the likelihood of runs left out: { $sureness }

## api: when to open

advice-blocked = { $limit ->
        [core_least] the core will not be hot enough within the forecast
        [core_most] the core is too hot
        [cure_bottom] the lower face will not be cured within the forecast
        [cure_top] the upper face will not be cured within the forecast
        [steam_most] too much steam, or its pressure is not known
       *[sudden_change] something has changed in the press: the cure of the faces so far is not known
    }
advice-estimate-old = as of { SPAN($seconds) } ago
advice-no-look-ahead = the live sensor has no forecast yet
advice-no-panel = no panel in the press
advice-no-target = no core target set
advice-not-closed = press not closed yet
advice-not-known = not known, because { $why }
advice-old = the last forecast is { SPAN($seconds) } old
advice-open-in = open in { NUMBER($seconds, maximumFractionDigits: 0) } s
advice-open-in-at-least = open in { NUMBER($seconds, maximumFractionDigits: 0) } s ({ NUMBER($low, maximumFractionDigits: 0) } or later)
advice-open-in-between = open in { NUMBER($seconds, maximumFractionDigits: 0) } s ({ NUMBER($low, maximumFractionDigits: 0) } to { NUMBER($high, maximumFractionDigits: 0) })
advice-open-in-or-later = open in { NUMBER($seconds, maximumFractionDigits: 0) } s (or later)
advice-open-now = OPEN NOW
advice-opened = opened
advice-opened-peak = opened, the core peaks at { NUMBER($peak_C, maximumFractionDigits: 0) } °C
advice-too-early = too early

## api: refusals of the server, access, health

alarm-body =
    { $what }
    Raised { $raised }, alarm { $number }.
alarm-core-above = { $press }: the core is above { NUMBER($limit, maximumFractionDigits: 1) } °C
alarm-drift = { $press }: { $coefficient } is at { NUMBER($percent, maximumFractionDigits: 0) } % of what it was since { $since }
alarm-file = { $path }: cannot be read: { $why }
alarm-language = email.language = { $language } is not available; choose one of { $known }
alarm-limits-crossed = the limit below which the platen is too cold ({ NUMBER($below_C) } °C) must lie below that above which it is too hot ({ NUMBER($above_C) } °C)
alarm-missing = there is no alarm { $number }
alarm-not-delivered = { $way }: alarm { $number } was not accepted, trying again: { $why }
alarm-platen-above = { $press }: { $channel } is above { NUMBER($limit, maximumFractionDigits: 1) } °C
alarm-platen-below = { $press }: { $channel } is below { NUMBER($limit, maximumFractionDigits: 1) } °C
alarm-silence = { $press }: no scan for more than { SPAN($limit) }
alarm-subject = Kerntemp: { $what }
alarm-thresholds-set = alarm limits of { $press } set: { $fields }
alarm-verdict = { $press }: the diagnosis leaves something unexplained
alarm-webhook-address = { $path }: the first line is no http or https address
api-address-taken = cannot listen on { $host }:{ $port }: { $why }; choose another port with --port
api-body-late = the body did not arrive within { $seconds } s
api-body-not-json = the body must be JSON, declared by Content-Type: application/json
api-body-number-too-long = a number of { NUMBER($count) } digits at '{ $key }': at most { NUMBER($digits) } are read; shorten it
api-body-too-deep = objects or lists more than { NUMBER($deepest) } deep within one another at '{ $key }'; flatten them
api-body-too-large = the body may have { $bytes } bytes at most
api-certificate-missing = { $path }: no such file; give certificate and key as PEM files
api-certificate-needs-key = --certificate and --key belong together; give both or neither
api-certificate-unusable = { $certificate }, { $key }: { $why }; give both as PEM, the key without password
api-change-needs-token = a change needs a token with scope write; kerntemp token create makes one
api-columns-empty = columns = { $columns } names no column; leave it out for all
api-field-invalid = { $field }: { $why }
api-field-name-invalid = { $field }: a name has letters, digits, _ and - only, with dots between them
api-header-key-fixed = header.{ $key }: cannot be changed as a header key; see remark
api-header-key-twice = header.{ $key }: cannot be a value and hold keys at once
api-header-not-a-number = header.{ $key } = { $value }: must be a number
api-instant-without-zone = { $instant } has no time zone; end it with Z or an offset
api-last-event-id-unknown = Last-Event-ID { $id } is not an id of this stream; leave it out
api-model-unknown = model { $version } does not exist; /api/v1/models lists them
api-next-panel = next panels of { $press }: { $recipe } { $fields }
api-no-curves = diagnosis { $number } has no curves: it does not exist, or was made by a version before 2026-11-23
api-no-night = there is no night { $number }
api-no-such-language = language { $language } is not available; choose one of { $languages }
api-nul-character = path and query: a NUL character belongs nowhere; leave it out
api-only-loopback-names = without a token only a loopback host name is answered here
api-panel-marked = run { $run }: panel marked: { $verdict }
api-panel-unmarked = run { $run }: mark of the panel taken back
api-press-unknown = there is no press '{ $press }'; there are: { $known }
api-query-unknown = query.{ $name }: unknown; known here: { $known }
api-query-unknown-of-none = query.{ $name }: unknown; none is known here
api-reading-needs-token = reading from elsewhere needs a token: Authorization: Bearer ...
api-request-invalid = { $problems }
api-run-changed = run { $run }: { $fields } changed
api-run-not-fitted = run { $run } has not been fitted; kerntemp refit fits it
api-run-not-simulated = run { $run } cannot be simulated: { $why }
api-run-unknown = run { $run } does not exist; /api/v1/runs lists them
api-run-without-press-file = run { $run }: its press was stored without a press file
api-scans-span = from { $begin } to { $end }: a stretch ends after it begins, and within 25 h; ask for a later end, or day by day
api-search-bound = '{ $bound }' is no bound; write for example core_at_opening_C>=95
api-search-order = '{ $order }' is no order; one of { $known }, or a header key
api-search-unknown = no run has the number '{ $name }'; there are { $known }
api-server-failed = the server failed on this request; see its log
api-slows-wrong-tokens = too many wrong tokens from { $address }; further ones are answered slowly
api-token-exists = token { $name } exists; revoke it first or choose another name
api-token-invalid = this token is not valid; kerntemp token create makes one
api-token-reads-only = token { $name } may read only; a change needs scope write
api-token-unknown = token { $name } does not exist; there are: { $known }
api-token-unknown-of-none = token { $name } does not exist; there is none yet
api-tokens-entry = an entry is not five texts: id, name, scope, sha256, created_utc
api-tokens-needed = server.host = { $host }: beyond loopback readers need tokens and there are none; make one with kerntemp token create NAME --scope read, or listen on 127.0.0.1
api-tokens-no-file = not a file of tokens
api-tokens-no-scope = token { $name } has no usable scope or sha256
api-tokens-unreadable = { $path }: cannot read the tokens: { $why }; remove the file and make new ones
api-too-many-listeners = too many live listeners; try again later
api-too-many-wrong-tokens = too many wrong tokens from this address; further wrong ones are answered slowly for a minute
health-archive-away = archive { $folder }: missing; mount its disk or copy the archive back; old runs cannot be read until then
health-archive-unsound = archive { $folder }: { $files ->
        [one] one file is
       *[other] { $files } files are
    } missing or damaged; the journal names them, copy them back from a backup of the archive
health-disk-nearly-full = less than { $gigabytes } GB left on the store's disk
health-never-seen = never seen
health-nightly-job-overdue = refit: the nightly job has not finished for { NUMBER($hours, maximumFractionDigits: 0) } h; see its log
health-process-never-seen = { $process }: never seen; start kerntemp { $command }
health-process-silent = { $process }: silent for { SPAN($seconds) }; start kerntemp { $command }
health-process-silent-for-hours = { $process }: silent for { NUMBER($hours, maximumFractionDigits: 0) } h; start kerntemp { $command }
health-process-stopped = { $process }: was stopped; start kerntemp { $command }
health-runs-damaged = { $runs ->
    [one] of the newest runs one is damaged
   *[other] of the newest runs { $runs } are damaged
} in store { $store } and cannot be read: { $names }; restore a backup beside the store with kerntemp backup --restore and take them from there
health-scans-behind = { $press }: { $scans } scans behind, this machine is too busy
what-if-busy = another what-if is being simulated; try again in some seconds
what-if-no-model = { $run }: there is neither a fit of this run nor a model in force

## api.commands: the command line

diagnosed-cause = { $name }: { $worth }; { $sureness }
diagnosed-causes = { $name } (not distinguished from { $others }): { $worth }; { $sureness }
diagnosed-next = Next: { $sentence }
diagnosed-plan = The next pressings worth most (details: kerntemp plan):
diagnosed-residual = residual { NUMBER($base, minimumFractionDigits: 3, maximumFractionDigits: 3) } K, extended model { NUMBER($extended, minimumFractionDigits: 3, maximumFractionDigits: 3) } K
terminal-backup-archive = the scans of { $runs ->
        [one] one run
       *[other] { $runs } runs
    } are in the archive: copy the folder { $folder } too
terminal-backup-contents = { $runs ->
        [one] one run
       *[other] { $runs } runs
    }, { $scans ->
        [one] one scan
       *[other] { $scans } scans
    }, { $fits ->
        [one] one fit
       *[other] { $fits } fits
    }, { $models ->
        [one] one model
       *[other] { $models } models
    }
terminal-backup-one-only = --verify and --restore exclude each other; give one: restoring checks the copy first
terminal-backup-restored = { $file } restored and compared: { $contents }
terminal-backup-sound = { $file } is sound: { $contents }
terminal-backup-written = { $file } written and checked: { $contents }
terminal-calibrate-added = { $path }: { $entries ->
        [one] one entry
       *[other] { $entries } entries
    } of { $day } added
terminal-calibrate-needs-mode = calibrate: give either --room with the thermometer's reading or --warm
terminal-calibrate-no-file = calibrate --write: no logger of { $config } has a calibration file; give one the name of a file to make, such as calibration = "{ $logger }.toml"
terminal-calibrate-not-kept = { $logger }: offsets not kept; give it the name of a file, calibration = "{ $logger }.toml"
terminal-calibrate-write-needs-room = calibrate: --write needs --room
terminal-channel-verdict = { $channel } { $verdict }
terminal-channels-fail = { $bad } of { $all } channels fail the check: { $names }
terminal-check-buffer = buffer { $file }: can be written, room for { NUMBER($hours, maximumFractionDigits: 1) } h of scans
terminal-check-failed = { $path }: { $failures }
terminal-check-logger-failed = press { $press }, logger { $logger }: { $why }
terminal-check-store-opens = store { $store }: opens
terminal-check-well-formed = { $path }: well formed
terminal-coefficients-no-object = { $path }: must be an object {"{"}NAME: value{"}"}
terminal-coefficients-not-json = { $path }: not JSON: { $why }
terminal-coefficients-or-model = --coefficients and --model exclude each other; give one
terminal-coefficients-unreadable = { $path }: cannot read the coefficients: { $why }
terminal-completion-shell = --completion { $shell }: there is bash, zsh and fish
terminal-config-missing = { $path }: no such configuration; write one (see the runbook, Connect a logger) or give --config
terminal-config-no-permission = { $path }: no permission to read it; put sudo before the command, or give another --config
terminal-demo-folder-taken = --data { $folder }: holds a store already; give a new folder, or remove it
terminal-export-needs-out = export needs --out: a file for one run, a folder for several
terminal-file-among-figures = { $path }: lies among the figures of --svg { $folder }; give it another place or ending
terminal-fit-from = from
terminal-fit-joint-median = joint median
terminal-fit-legend = W/m²K; ? marks a coefficient that the run does not determine, at a mean one that no run determines. Coefficients fixed by the press file are not listed.
terminal-fit-legend-campaign = Mean and sd: over the runs that determine the coefficient. Joint median: all runs together, with its 95 % interval.
terminal-fit-mean = mean
terminal-fit-needs-runs = fit needs run files and --press FILE (or --reproduce-paper alone)
terminal-fit-remark-of = { $count } of { $total } runs, such as { $run }: { $remark }
terminal-fit-remarks-kept = What is remarked on every single run stands in the files of --json and --html.
terminal-fit-run = run
terminal-fit-sd = sd
terminal-fit-shared = One value in all runs, with one interval: { $names }.
terminal-folder-for-several = { $path }: several runs need a folder; give the name of one in a folder that exists
terminal-folder-is-a-file = --svg { $folder }: is a file; give a folder
terminal-folder-name-empty = the folder's name is empty; give one, or . for the folder you are in
terminal-guide-folder = { $folder }: is there and not empty; name a new folder
terminal-guide-written = guide, gallery and reference: open { $page }
terminal-hide-unknown = --hide: { $why }
terminal-hold-one-now = Hold one thermocouple between two fingers now.
terminal-import-run-twice = two of the files hold run '{ $run }'; give one a key '# run = ...' of its own
terminal-imported = { $runs ->
    [one] { $runs } run stored
   *[other] { $runs } runs stored
}
terminal-interrupted = interrupted
terminal-language-unknown = KERNTEMP_LANGUAGE = { $language } is not available; choose one of { $languages }
terminal-list-alone = --press, --material, --from and --to choose what is listed; runs to be exported are named
terminal-list-created = created
terminal-list-damaged = damaged
terminal-list-material = material
terminal-list-material-unknown = --material = '{ $material }': no run has it; the runs have { $known }
terminal-list-name = name
terminal-list-press = press
terminal-list-run = run
terminal-list-scope = scope
terminal-list-started = started
terminal-list-status = status
terminal-list-token = token
terminal-model-in-force-again = { $press }: model { $version } is in force again
terminal-needs-package = kerntemp publish needs { $package }: install kerntemp[plant]
terminal-no-channel-rose = no single channel rose clearly ({ $rises }); hold one junction longer, alone
terminal-no-store-here = no store: neither { $config } nor { $store } is here; give --store or --config
terminal-not-noted = { $what }; not noted in the journal: { $why }
terminal-output-is-input = { $path }: is read by this command and would be overwritten; give another name
terminal-output-no-folder = { $path }: no folder { $folder }; make it first
terminal-output-not-a-file = { $path }: is a folder; give a file name
terminal-output-twice = { $path }: is given for two outputs; give each a name of its own
terminal-output-unwritable = { $path }: cannot write: { $why }
terminal-press-enter = Press Enter after some ten seconds
terminal-probe-answers = { $place }: Modbus answers from stations { $stations }
terminal-probe-answers-none = { $place }: no station answers Modbus
terminal-probe-for-configuration = for kerntemp.toml; name the channels
terminal-probe-nothing-known = { $place }: no known logger reads room temperature here; check power, cable, address and baud rate
terminal-probe-reading = { $meaning }: { $percent } % at room temperature: { $values }
terminal-probe-reads-as-well = fits equally well: { $profiles }; look at the device's label
terminal-probe-registers = station { $station }, function { $function }: registers from 0, read as
terminal-program-key-twice = --program { $setting }: { $key } is given twice; a program has one value of it
terminal-program-no-number = --program { $setting }: '{ $value }' is no number
terminal-program-not-known =
    { $runs ->
        [one] --program: one run cannot show what { $settings } does; give at least 8 runs that differ in it (6 where only one setting varies)
       *[other] --program: { $runs } runs cannot show what { $settings } does; give at least 8 runs that differ in it (6 where only one setting varies)
    }
terminal-program-out-of-range = --program { $setting }: must lie between 0 and { $most } { $unit }
terminal-program-unknown-key = --program { $setting }: must be KEY=VALUE with KEY one of { $known }
terminal-progress-advising = Trying programs
terminal-progress-blisters = Replaying { $runs ->
        [one] one run
       *[other] { $runs } runs
    }
terminal-progress-copying = Copying { $store }
terminal-progress-diagnosing = { $runs ->
    [one] Diagnosing { $runs } run
   *[other] Diagnosing { $runs } runs
}
terminal-progress-exporting = { $runs ->
    [one] Reading { $runs } run
   *[other] Reading { $runs } runs
}
terminal-progress-fitting = { $runs ->
    [one] Fitting { $runs } run
   *[other] Fitting { $runs } runs
}
terminal-progress-guide = Writing the pages
terminal-progress-planning = { $runs ->
    [one] Planning after { $runs } run
   *[other] Planning after { $runs } runs
}
terminal-progress-predicting = Predicting { $run }
terminal-progress-reading = { $files ->
    [one] Reading { $files } run file
   *[other] Reading { $files } run files
}
terminal-progress-reading-runs = { $runs ->
    [one] Reading { $runs } run
   *[other] Reading { $runs } runs
}
terminal-progress-refitting = Refitting { $presses ->
    [one] one press
   *[other] { $presses } presses
}
terminal-progress-rehearsing = Diagnosing { $campaigns } simulated campaigns
terminal-progress-reproducing = { $runs } virtual measurements, four ways each
terminal-progress-restoring = Restoring { $file }
terminal-progress-simulating = Simulating { $run }
terminal-progress-storing = { $runs ->
    [one] Storing { $runs } run
   *[other] Storing { $runs } runs
}
terminal-progress-writing = Writing files
terminal-refit-failed = { $failures }; the journal names them
terminal-refit-report = { $press }: report { $page }
terminal-refit-unfit = { $press }: { $failed } of { $runs } runs could not be fitted
terminal-reproduce-alone = --reproduce-paper makes its own measurements and does not take { $surplus }; it goes with --json, --html and --svg
terminal-rise = { $logger }: largest { NUMBER($rise, minimumFractionDigits: 1, maximumFractionDigits: 1) } K, next { NUMBER($next, minimumFractionDigits: 1, maximumFractionDigits: 1) } K
terminal-room-check = { $channel } { NUMBER($mean, minimumFractionDigits: 2, maximumFractionDigits: 2) } °C, { $deviation } off, noise { NUMBER($noise, minimumFractionDigits: 2, maximumFractionDigits: 2) } K: { $verdict }
terminal-room-no-value = { $channel } { $verdict } ({ $quality })
terminal-rose = { $channel } ({ $logger }) rose by { NUMBER($rise, minimumFractionDigits: 1, maximumFractionDigits: 1) } K
terminal-run-file-ending = { $path }: a run file ends in .csv or .parquet, event documents in .jsonl
terminal-run-neither-file-nor-stored = { $run }: no such file, and no store to look in; give a file, --store or --config
terminal-serves = kerntemp serves { $address }
terminal-stations-no-numbers = --stations '{ $text }': give numbers and ranges, such as 1-4,9
terminal-stations-out-of-range = --stations '{ $text }': addresses lie between 0 and 255
terminal-token-needs-name = kerntemp token { $action }: needs a name
terminal-unexpected = { $kind }: { $why } (KERNTEMP_TRACEBACK=1 shows where)
terminal-until-leaves-too-little = { $run }: { $option } { $until } leaves { $rows } of { $all } rows; the first is at time_s = { $first }: give a later moment
terminal-until-no-column = { $run }: { $option } names column '{ $column }'; the run has { $known }
terminal-until-no-run = { $option } { $until }: no run '{ $run }' is given; runs are { $known }
terminal-until-not-reached = { $option } { $until } does not come in { $runs }: nothing is left out there; give seconds, or a temperature that is reached
terminal-until-not-read = { $option } { $until }: give seconds (900), a temperature of a column (bottom_1=140) or one of { $events }, with RUN: before it for one run alone
terminal-written = written: { $path }
terminal-written-several = written: { $files } files in { $folder }
token-created = token { $name } created, scope { $scope }
token-revoked = token { $name } revoked

## api.commands: help, and calls that are wrong

call-command-missing = no command given; kerntemp --help lists them
call-command-unknown = { $command }: no such command; kerntemp --help lists them
call-command-unknown-meant = { $command }: no such command; did you mean { $meant }?
call-not-one-of = must be one of { $known }
call-option-unknown = { $option }: no such option; --help lists them
call-option-unknown-meant = { $option }: no such option; near it are { $meant }
call-option-without-value = { $option }: needs a value
call-surplus = too much in this call: { $words }; put quotes around a text with blanks
help-advice-range = What can be set, and how far: platen_temperature_C, press_time_s or pressure_N_cm2. May be repeated; without it { $platen_from } to { $platen_to } °C, { $time_from } to { $time_to } s and { $pressure_from } to { $pressure_to } N/cm².
help-advice-resin = The resin file: kinetics, sorption and limits at opening.
help-advice-svg = Draw press time against risk here.
help-arguments = Arguments:
help-averages = With a method of the paper: averages of the upper and of the lower sensors, not every sensor.
help-backup-file = The copy: a new SQLite file.
help-baud = Baud rate of the serial line; without it { $baud }.
help-calibrate-write = Add the offsets found to each logger's calibration file.
help-certificate = TLS certificate chain, PEM.
help-coefficients = Coefficients, a flat {"{"}NAME: value{"}"}.
help-command-advise = Work out press time and platen temperature for a panel not pressed yet, so that all limits hold with a wanted probability.
help-command-backup = Copy the store while others write to it. The copy is checked before it gets its name.
help-command-blisters = Learn from panels marked good or blistered how much steam they withstand, for the limit in the resin file.
help-command-calibrate = Check all channels at room temperature (--room), or find swapped ones (--warm). Stop kerntemp record first.
help-command-check = Check the configuration and the store, and read every logger once.
help-command-demo = Run everything on a virtual press: logging, live prediction, refits and the page.
help-command-diagnose = Find what the simulation gets wrong, why, what it costs, and what to measure next.
help-command-export = Write runs of the store as run files, or list the runs.
help-command-fit = Fit the heat transfer coefficients of each run and of the campaign.
help-command-guide = Write the guide, the gallery and the reference as pages into a folder, to be read without a server.
help-command-import = Put run files into the store: all of them, or none if one is wrong.
help-command-kerntemp = Core temperature of pressed panels: log, predict live, fit, and find what the model gets wrong.
help-command-plan = Find the next pressings worth most, and what each would settle.
help-command-predict = Replay a run scan by scan through the live sensor; no row uses later readings.
help-command-probe = Find out which logger is on a wire, with the sensors at room temperature. No device at hand? python -m daq.simulated.devices_serve adam-4118 puts a simulated one on a wire.
help-command-publish = Feed an MQTT broker ([mqtt]) and run an OPC UA server ([opcua]), without end.
help-command-record = Log all presses of the configuration, without end.
help-command-refit = The nightly job: refit all runs, diagnose, and put a better model into force.
help-command-sense = Predict the core live on all presses of the configuration, without end.
help-command-serve = Serve the page and the REST interface; to other machines only with tokens.
help-command-simulate = Simulate a run from its platen temperatures alone.
help-command-token = Make, list and revoke access tokens. A new one is shown once.
help-commands = Commands:
help-completion = Print what makes a shell complete commands and options with Tab (bash, zsh, fish).
help-config = The configuration; without it kerntemp.toml in this folder.
help-core-least = Temperature the core must have at opening.
help-core-most = Temperature the core may have at opening.
help-dask = A Dask scheduler whose workers take the presses, or the fits of a single one; see [refit] dask.
help-data = Keep everything in this folder.
help-default = { $text } [default: { $value }]
help-device-host = Address of a device on the network.
help-environment = { $text } [or the environment variable { $name }]
help-export-format = Format of the files in a folder; jsonl holds documents of bluesky's event model.
help-export-out = A file for one run, a folder for several.
help-export-runs = Ids of runs; without any, the runs are listed.
help-goal = What to look for: time, energy or throughput.
help-guide-folder = A new folder; its index.html is the first page.
help-help = Show this page.
help-hide = Switch this effect on in the virtual press only.
help-host = Address to listen on; without it the configuration's.
help-html = Write a report to read here.
help-import-files = Run files, or another logger's own files with --mapping.
help-json = Write everything as JSON here.
help-key = The certificate's private key, PEM.
help-law = Estimate what is missing as a free function of time, temperature or depth, also where a cause is named; where the verdict is unknown_effect this is done anyway.
help-licences = List what is shipped or installed with it, with its licence.
help-list-from = List only runs begun on this day or later, such as 2026-03-04.
help-list-material = List only panels of this material.
help-list-press = List only runs of this press.
help-list-to = List only runs begun before this day.
help-mapping = A mapping that explains another logger's files, TOML.
help-method = default, or one of the paper's: least_squares, nelder_mead, nelder_mead_then_least_squares.
help-model = A model file, as fit and diagnose write it.
help-model-out = Write the campaign's model file here.
help-offline = Do not read the loggers.
help-open = How long the press is open between two panels, for energy and throughput.
help-options = Options:
help-out = Write the table here.
help-page-port = Port of the page; 0 takes a free one.
help-panel = A key of a run's header that describes the panel or the room, such as panel.thickness_mm=16. May be repeated; without it { $material } of { $millimetres } mm.
help-period = Time between two readings.
help-port = Port; 0 takes a free one and shows it.
help-press = The press file.
help-pressings = Stop after this many pressings; without it at Ctrl-C.
help-price = Price of a kWh in euros.
help-probability = Probability with which all limits are to hold; without it the resin file's, or { $probability }.
help-program = A press program never run, by its settings: its coefficients are predicted from the campaign's. May be repeated.
help-range = What can be set, and how far: platen_temperature_C, press_time_s, thickness_mm, start_temperature_C, waiting_s or pressure_N_cm2. May be repeated; without it the runs' own range, modestly widened.
help-rehearse = Simulate such campaigns from the sensor's own model, with each cause hidden in turn and none, diagnose them, and report how often a cause is found and how often a wrong one is named.
help-rehearse-campaigns = Simulated campaigns of each cause; without it { $campaigns }.
help-rehearse-dask = A Dask scheduler whose workers take the simulated campaigns.
help-rehearse-effect = Hide only this cause, at a size of its own if one is given. May be repeated; without it all that these runs could show.
help-rehearse-file = Keep each finished simulated campaign in this file, and go on from there if broken off.
help-reproduce-paper = Instead: why gradient least squares got stuck, shown on { $measurements } virtual measurements. --json, --html and --svg keep the table and the cost along one coefficient.
help-resin = How the paper cures and what must hold at opening (TOML): adds cure, steam and open_now.
help-restore = Fill a new, empty store from the copy.
help-roll-back = Only go back to this press's model before.
help-room = Temperature of the room, from a thermometer beside the sensors, { $least } to { $most } °C.
help-run = A run file, or the id of a run in the store.
help-runs = Run files, or ids of runs in the store.
help-scope = write includes read.
help-seed = Another number is another press.
help-serial-port = Serial port: /dev/ttyUSB0, COM5, or socket://host:port.
help-shared = A coefficient with one value in all runs. May be repeated.
help-speed = Times real speed, { $least } to { $most }.
help-stations = Addresses to try, such as 1-4,9.
help-store = The store: a path, or a postgresql:// URL.
help-svg = Write every figure into this folder as SVG.
help-tcp-port = TCP port of the device; without it { $port }.
help-timeout = Time to wait for a reply, { $least } to { $most }; without it { $seconds }.
help-token-action = What to do.
help-token-name = Whom the token is for.
help-transport = How Modbus is spoken; without it the place decides.
help-until = Leave out the rows of each run after this: a moment of time_s, a temperature that a column reaches (bottom_1=140), or inserted, closed, opened, removed. RUN:... is one run's own. May be repeated; the earliest counts.
help-usage = Usage: { $call }
help-verify = Only check an existing copy.
help-version = Show the version.
help-wait = Time to warm it by hand; without it Enter ends the wait.
help-waiting = From laying the panel in to closing.
help-warm = Find the thermocouple that is warmed by hand.
help-without = Columns to hide, separated by commas; patterns such as top_* are allowed.
help-word-address = ADDRESS
help-word-args = ARGS
help-word-celsius = CELSIUS
help-word-column = COLUMN
help-word-columns = COLUMNS
help-word-command = COMMAND
help-word-day = DAY
help-word-dir = DIR
help-word-effect = EFFECT
help-word-event = EVENT
help-word-file = FILE
help-word-folder = FOLDER
help-word-high = HIGH
help-word-key = KEY
help-word-list = LIST
help-word-low = LOW
help-word-name = NAME
help-word-options = OPTIONS
help-word-out = OUT
help-word-port = PORT
help-word-press = PRESS
help-word-run = RUN
help-word-seconds = SECONDS
help-word-shell = SHELL
help-word-size = SIZE
help-word-value = VALUE
help-workers = Processes on this machine; see [refit] workers.

## api.plant: feeds

plant-address-taken = cannot listen on { $host }:{ $port }: { $why }; set opcua.port
plant-broker-not-connected = MQTT broker { $where } did not accept the connection: { $why }; trying again
plant-broker-not-subscribed = MQTT broker { $where } did not send back what it keeps: { $why }; trying again
plant-broker-not-taking = MQTT broker { $where } did not accept a message: { $why }; trying again
plant-broker-refused = refused: { $reason }
plant-broker-silent = no answer
plant-broker-unreachable = MQTT broker { $where }: { $why }; check that it runs and is reachable
plant-certificate-missing = { $path }: no such file; give certificate and key as DER or PEM files
plant-certificate-needed = opcua.host = { $host }: beyond loopback a certificate is needed; give one and its key
plant-certificate-needs-key = opcua.certificate and opcua.key belong together; give both or neither
plant-client-fault = OPC UA client { $address }: { $why }{ $left_out ->
    [0] {""}
   *[other] ; { NUMBER($left_out) } more like it since the last line
}
plant-feeds-broker = feeding MQTT broker { $where }
plant-messages-sent = { $messages ->
    [one] { $messages } message sent
   *[other] { $messages } messages sent
}
plant-no-sign-of-life = no sign of life can be written now: { $why }
plant-node-core = Predicted core temperature
plant-node-core-high = Upper end of the 95 % band of the core temperature
plant-node-core-low = Lower end of the 95 % band of the core temperature
plant-node-core-sd = Standard deviation of the core temperature
plant-node-event = The last press event: inserted, closed, opened or removed
plant-node-model = Model version the estimate comes from
plant-node-open-now = Whether the press may open now: every limit of the resin file holds; false where anything is not known
plant-node-pressure = Pressure { $channel }
plant-node-reason = Why there is no estimate, empty while there is one
plant-node-run = The run being recorded, empty between two pressings
plant-node-state = idle (no panel), open, closed or unknown
plant-node-thermocouple = Thermocouple { $channel }
plant-node-wire = Wire { $channel }, 1 for closed
plant-nothing-configured = { $path }: neither [mqtt] nor [opcua]; add the one your plant reads
plant-password-unreadable = { $path }: cannot read the broker's password: { $why }
plant-retained-foreign = press { $press }: the broker keeps a { $kind } message with number { $number } that is not of this store; everything after the last message known to have arrived is sent
plant-server-fault = OPC UA server: { $why }{ $left_out ->
    [0] {""}
   *[other] ; { NUMBER($left_out) } more like it since the last line
}
plant-tokens-needed = opcua.host = { $host }: beyond loopback clients need a token as password and there are none; make one with kerntemp token create NAME --scope read

## api.demo: the demonstration

demo-begins = A virtual press at { NUMBER($speed) } times real speed, { $pressings ->
    [one] { $pressings } pressing
   *[other] { $pressings } pressings
}.
demo-begins-without-end = A virtual press at { NUMBER($speed) } times real speed, until Ctrl-C.
demo-column-band = in band
demo-column-band-unit = of 95 %
demo-column-closing = closing
demo-column-core = core error
demo-column-core-unit = live, rms
demo-column-found = found-true
demo-column-opening = opening
demo-column-run = run
demo-column-scans = scans
demo-column-surface = residual at rest
demo-column-surface-unit = before, after fit
demo-column-worst = worst
demo-compiling = First start: compiling the model takes about a minute ...
demo-core-off = core { NUMBER($kelvin, minimumFractionDigits: 2, maximumFractionDigits: 2) } K off
demo-core-unknown = core not known
demo-diagnosis-there = Diagnosis: { $diagnosis }; what the night did: { $night }
demo-did-not-start = { $process } did not start: { $why }
demo-ended = { $process } ended with status { $status }: { $why }
demo-gain = Live core error on the last { $runs } runs: { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } K as it was reported, { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K with the promoted model
demo-heldout = Runs left out in turn, own contacts fitted: { $plain } K off with the plain model, { $extended } K with the extended one
demo-hidden = Hidden in the virtual press: { $effects }
demo-kept = Kept in { $folder }; to look at it again: kerntemp serve --config { $config }
demo-logger = { $profile } at { $place }
demo-loggers = Loggers  { $places }
demo-named = Nightly job: verdict “{ $verdict }”, { $causes }
demo-named-none = Nightly job: verdict “{ $verdict }”, no cause named
demo-next = Next measurement: { $what }
demo-night = Nightly job: refitting all runs and looking for what the model gets wrong ...
demo-night-awaited = Waiting for it; Ctrl-C ends the demonstration without its answer.
demo-night-comes = After { $pressings ->
        [one] one pressing
       *[other] { $pressings } pressings
    }, in about { $minutes } min, the nightly job looks for what the model gets wrong; the page stays until Ctrl-C.
demo-night-left = The nightly job was under way and is ended with the demonstration.
demo-no-diagnosis = The nightly job wrote no diagnosis.
demo-no-message = no message
demo-no-pressing = no run was recorded for too long; the logs are beside the store
demo-no-sign-of-life = no sign of life from { $processes } in { $seconds } s
demo-not-fitted = { $runs ->
    [one] { $runs } run was not fitted in time
   *[other] { $runs } runs were not fitted in time
}
demo-not-found = { $runs ->
    [one] { $runs } pressing was not found
   *[other] { $runs } pressings were not found
}
demo-not-kept = Nothing of it is kept; --data DIR keeps it all.
demo-not-promoted = Model { $version } was not promoted: { $why }
demo-page = Page     { $address }
demo-pressing = Run { $run }: { $scans } scans, closing { NUMBER($closing, minimumFractionDigits: 2, maximumFractionDigits: 2) } s and opening { NUMBER($opening, minimumFractionDigits: 2, maximumFractionDigits: 2) } s off, residual at rest from { NUMBER($before, minimumFractionDigits: 2, maximumFractionDigits: 2) } to { NUMBER($after, minimumFractionDigits: 2, maximumFractionDigits: 2) } K, { $core }
demo-scans-left-out = { $left_out } of { $all } scans were left out
demo-store = Store    { $path }
demo-stored = Compared with the virtual press: { $runs } runs, { $scans } scans
demo-summary = Summary of { $runs ->
    [one] { $runs } pressing
   *[other] { $runs } pressings
} on the virtual press
demo-token = To change something on the page, make a token and give it there under Access: kerntemp token create operator --scope write --config { $config }
demo-too-slow = This machine did not keep up with { NUMBER($speed) } times real speed: { $troubles }; give a lower --speed
demo-view = { "         " }{ $address }  { $name }

## deploy: the installer

setup-building = building the wheel of { $folder }
setup-command-failed = { $name } failed: { $why }
setup-compiling = compiling the model; this takes about a minute once
setup-complete = Kerntemp { $version } has all that { $file } asks for: { $extras }.
setup-config-unreadable = { $file }: { $error }; correct it first
setup-installed = Kerntemp { $version } is installed.
setup-installing = installing version { $version } in { $folder }
setup-kept-newer = what version { $version } recorded is kept in { $file }
setup-needs-root = needs root; use sudo
setup-needs-venv = { $why }; apt-get install python3-venv
setup-needs-wheel = no wheel given, and this file does not lie in Kerntemp's sources; give the wheel
setup-next = Next: edit { $file }, then: kerntemp check && systemctl start kerntemp.target
setup-no-wheel = { $file }: not a wheel; give the file kerntemp-VERSION-py3-none-any.whl
setup-nothing-before = there is no version to go back to
setup-other-version = the installed program gives its version as '{ $found }', expected { $version }
setup-other-wheel = { $file }: holds { $name }, not kerntemp
setup-removed = Kerntemp is removed. Configuration and data are still in { $settings } and { $data }.
setup-restore-postgresql = PostgreSQL: the copy goes into the database of store.url, a new and empty one
setup-rollback-partly = version { $version } is in force again, but not all of it runs
setup-rolled-back = Kerntemp { $version } is in force again.
setup-schema-changes = the store's schema changes from { $before } to { $after }: recording stops for the backup
setup-store-still-newer = the store is still version { $version }'s: { $why }
setup-there-already = version { $version } is installed already; { $folder }
setup-update-partly = version { $version } is in force, but not all of it runs; rollback goes back to { $old }
setup-updated = Kerntemp { $version } is in force; python3 kerntemp_setup.py rollback goes back to { $old }.
setup-use-install = nothing is installed; use install
setup-use-update = version { $version } is installed; use update
setup-version-gone = version { $version } is no longer in { $folder }; install its wheel with update

## page: the press now

page-at-opening = At opening
page-band-from = The band comes from
page-band-from-constants = the panel's constants
page-band-from-contacts = contacts
page-band-from-discrepancy = what the model lacks
page-band-from-effects = effects in the model
page-band-from-panel = the thickness, new to this press
page-band-from-start = start and platen temperatures
page-band-from-suspected = suspected causes
page-band-from-timing = moments of the press
page-chart-now-label = Temperatures of the pressing over time, with the predicted core and its 95 % band
page-core-behind = The live sensor has not processed the last { $time } of the readings: the core's curve ends before them.
page-core-foreseen = Core, forecast if the press stays closed
page-cure = Cure, less cured face
page-curves-missing = The curves of this pressing cannot be loaded: { $why }
page-energy = Heat taken up
page-faces-and-platens = Faces and platens
page-grade-glossy = glossy
page-grade-matt = matt
page-grade-undercured = undercured
page-last-pressing = Last pressing
page-left-out-channel = lately { $kelvin } K { $side ->
    [below] below
   *[above] above
 } its neighbours, not used
page-limit-in = Limit in
page-no-estimate = No prediction yet
page-no-press = No press yet
page-no-press-hint = A press appears here as soon as its recorder begins: 'kerntemp record' with a configuration; that of 'kerntemp demo' within half a minute of its start.
page-open-then = open
page-press = Press
page-running-pressing = Running pressing
page-sensor-starting = the live sensor is starting; the first time this takes about a minute
page-stale-since = No new reading since { $time }
page-steam = Steam
page-time-since-closing = Since closing
page-waiting-for-pressing = Waiting for the first pressing
page-wall = Wall view

## page: the wall

page-full-screen = Full screen
page-health-core-unknown = all runs, core not known
page-health-degraded = degraded
page-health-ok = all well
page-health-runs = all runs

## page: the next panel

page-moisture = Moisture
page-next-faces = The faces now: { $top } above, { $bottom } below
page-next-hint = Holds for every pressing until changed; the start temperature for one.
page-next-kept = Kept: the next pressing begins with it.
page-next-panel = Next panel
page-panel-verdict = What became of panel { $run }?
page-recipe-name = Keep as recipe
page-recipe-none = without recipe
page-start-temperature = Start temperature

## page: alarms

page-alarm-core = Core above
page-alarm-drift = Drift of at least
page-alarm-drift-hint = Drift is raised by a coefficient's control chart, once enough pressings have been fitted; changes smaller than this are left out of it.
page-alarm-here = In this browser
page-alarm-limits = Limits of { $press }
page-alarm-limits-hint = Empty: no limit. To notify people by e-mail or webhook: [email] and [webhook] of kerntemp.toml.
page-alarm-limits-kept = Limits kept.
page-alarm-new = Kerntemp: alarm
page-alarm-no-leave = The browser does not allow notifications here.
page-alarm-no-number = { $name }: a number is needed
page-alarm-notification = Notify when an alarm is new
page-alarm-over = over { $time }
page-alarm-platen-above = Platen above
page-alarm-platen-below = Platen below
page-alarm-silence = No reading for
page-alarm-sound = Sound when an alarm is new
page-alarm-sound-waits = Sound is switched on; the browser plays none before a click or a key on this page.
page-alarm-stands = stands
page-alarm-take = Acknowledge
page-alarm-take-this = Acknowledge: { $what }
page-alarm-taken = Acknowledged
page-alarm-verdict = When the diagnosis leaves something unexplained
page-no-alarms = No alarm yet.

## page: runs

page-all = all
page-all-channels = all other channels
page-and-more = and { $count } more
page-band-at-opening = Band at opening
page-blisters = Steam that panels of { $press } withstand
page-blisters-chance = Chance of a blister
page-blisters-marked = Marked panels
page-blisters-none = No panel is marked good or blistered yet.
page-cancel = Cancel
page-change = Change
page-changes = Changes
page-compare = Compare
page-compare-loose = Closing not known; drawn from the first scan: { $runs }
page-compare-without = Not known for { $runs }
page-converged = converged
page-core-at-opening = Core at opening
page-core-peak = Core, highest
page-differences = Settings and results
page-dots-measured = dots: measured, mean of the sensors
page-empty-removes = An empty value removes the line. Who changed what is recorded.
page-fit = Fit
page-fit-left = RMSE { $before } K at the guesses → { $after } K
page-fit-left-still = while neither press nor panel is being moved { $before } K at the guesses → { $after } K
page-from = From
page-further-off = further off than its guesses
page-isotherm = white: { $temperature } °C
page-left-out = Missing or simulated readings
page-measured = measured
page-measured-and-core = Measured, and the core as predicted live
page-measured-simulated = Measured against simulated
page-metadata = Metadata
page-new-key = New name
page-no-fit = Not fitted yet.
page-no-runs = No runs match.
page-no-runs-lacking = No run has { $names } yet.
page-no-simulation = No simulation for this run.
page-not-converged = not converged
page-not-described = not described by the model
page-number-ambient-temperature_C = Ambient temperature [°C]
page-number-band_at_opening_K = Band at opening [K]
page-number-core_at_opening_C = Core at opening [°C]
page-number-core_peak_C = Core, highest [°C]
page-number-panel-conductivity_W_mK = Conductivity of the panel [W/mK]
page-number-panel-density_kg_m3 = Density of the panel [kg/m³]
page-number-panel-heat_capacity_J_kgK = Heat capacity of the panel [J/kgK]
page-number-panel-initial_temperature_C = Start temperature [°C]
page-number-panel-material = Material
page-number-panel-moisture_percent = Moisture [%]
page-number-panel-thickness_mm = Thickness [mm]
page-number-panel-verdict = Panel became
page-number-press_time_s = Pressed [s]
page-number-recipe = Recipe
page-number-rmse_K = Fit RMSE [K]
page-number-setting-core_target_C = Core target [°C]
page-number-setting-platen_temperature_C = Platen temperature, set [°C]
page-number-setting-press_time_s = Press time, set [s]
page-number-setting-pressure_N_cm2 = Pressure, set [N/cm²]
page-pressed = Pressed
page-profile = Temperature through the panel
page-profile-axes = Time to the right, bottom face below, top face above
page-profile-label = Picture of the temperature through the thickness over time
page-quantity = Quantity
page-reference = Minus
page-remark = Remark
page-residual = Residual: measured minus simulated
page-rmse = Fit RMSE
page-rmse-hint = RMSE as in the fit: every good channel, its constant offset removed, the whole run.
page-scans = scans
page-scatter = One number over another
page-scatter-newest = Of the newest { $count } runs found; a narrower search finds others.
page-scatter-of = Shows { $shown } of { $count ->
        [one] one run
       *[other] { $count } runs
    }{ $lacking ->
        [0] { "." }
        [one] { "; one has no value for one of the two numbers." }
       *[other] ; { $lacking } have no value for one of the two numbers.
    }
page-scatter-right = to the right
page-scatter-up = up
page-search = Search
page-search-bounds = Values
page-simulated = simulated
page-simulating = Simulating this run …
page-state-closed = closed
page-state-open = open
page-to = To
page-what-if = What if
page-what-if-as-it-was = As it was, simulated
page-what-if-ask = Simulate
page-what-if-asked = With these settings
page-what-if-hint = The same panel between platens that follow the press as they did, in a band of all that is not known of it.
page-what-if-moisture_percent = Moisture [%]
page-what-if-platen_temperature_C = Platens [°C]
page-what-if-press_time_s = Press time [s]
page-what-if-pressure_N_cm2 = Pressure [N/cm²]
page-what-if-start_temperature_C = Start temperature [°C]
page-what-if-thickness_mm = Thickness [mm]
page-what-if-waiting_s = Wait before closing [s]

## page: the journal

journal-note = Note: { $text }
journal-press-closed = The press closes
journal-press-inserted = A panel is inserted
journal-press-opened = The press opens
journal-press-removed = The panel is removed
page-journal-empty = Nothing of this kind.
page-level = Level
page-level-alarm = alarm
page-level-info = info
page-level-warning = warning
page-note = Note at { $press }
page-note-keep = Keep note
page-note-kept = The note is kept
page-press-events = Presses
page-repeated = { $count } times in { $time }

## page: loggers

page-archive = Archive
page-archive-holds = { $runs ->
        [one] one run
       *[other] { $runs } runs
    }, { $size }{ $unsound ->
        [0] { "" }
       [one] ; one file missing or damaged
       *[other] ; { $unsound } files missing or damaged
    }
page-channel = Channel
page-clock = Clock
page-clock-here = Against this screen
page-clock-never = not since recording
page-clock-set = Last set
page-crc-errors = CRC errors
page-free = Free on disk
page-gaps = Gaps, last hour
page-health-down = down
page-hours-left = Lasts for
page-kind = Kind
page-last-good = Last good
page-last-sign = Last sign of life
page-logger = Logger
page-newest-scan = Newest scan
page-no-channels = No channel yet.
page-other-faults = Other faults
page-process = Process
page-process-done = done
page-process-running = running
page-process-starting = starting
page-process-stopped = stopped
page-processes = Processes
page-readings = Readings
page-reconnects = Reconnects
page-silent = silent
page-size = Size
page-store = Store
page-timeouts = Timeouts

## page: coefficients

page-against = Against
page-c-h_ap = press – air
page-c-h_p_c = platen – plate, closed
page-c-h_p_o = platen – plate, open
page-c-h_pp_c = plate – panel, closed
page-c-h_pp_o = plate – panel, open
page-c-h_wa = panel – air
page-ci-high = high
page-ci-low = low
page-coefficients-hint = Heat transfer coefficients refitted after each pressing, with 95 % intervals. Grey dots: not identifiable from that run.
page-coefficients-sisters = Until runs of its own determine them better, the coefficients of this press are { $why }.
page-drift = Drift
page-drift-creep = creeping by { $change } since { $run }
page-drift-hint = A control chart asks after each run whether a coefficient's values still lie among the earlier ones as if nothing had changed.
page-drift-jump = jumped by { $change } at { $run }
page-drift-none = none has shown itself
page-history = history
page-identifiable = identifiable
page-last-fit = Last fit
page-no-fits = No fitted run yet.
page-not-identifiable = not identifiable
page-order-of-runs = order of runs

## page: diagnosis

page-all-sensors = all sensors
page-cause = Cause
page-core = core
page-curves = Measured and simulated: { $run }
page-curves-hint = The run the plain model fits worst. Dots: mean of the sensors. Below: measured minus model.
page-curves-residual = { $place }: measured minus model
page-earlier = Earlier diagnoses
page-effects = Effects
page-evidence = Evidence: gain on a typical unseen run, by cause
page-evidence-other = The longest bar, { $cause }, is not the cause named: a bar shows what a cause saves by itself, and the choice depends on how consistently the runs prefer a cause.
page-explains = explains { NUMBER($percent, maximumFractionDigits: 0) } % of what the runs have in common
page-gain-left-out = less error in runs left out, their own contacts fitted
page-gain-predicted = less error in predicted runs
page-heldout = left out, own contacts fitted, root mean square of all runs
page-heldout-gain = gain on runs left out
page-luck = chance that luck alone would do as well
page-measured-there = Measured there
page-model-rejected = rejected
page-models = Model versions
page-next-measurement = Next measurement
page-no-diagnosis = No diagnosis yet.
page-no-diagnosis-hint = The nightly job 'kerntemp refit' writes one as soon as there are enough runs.
page-no-gain = No cause lowers the error on unseen runs.
page-no-models = No model version yet.
page-noise-floor = noise floor
page-nowhere = Nowhere beyond the noise.
page-nowhere-sought = Not looked for: there is no verdict on these pressings.
page-off-by = Off by
page-or = or
page-parameter = Parameter
page-place = Place
page-plain-extended = plain → extended
page-plain-model = plain model
page-predicted = predicted, root mean square of all runs
page-promote = Promote
page-promote-question = Use model version { $version } for the live prediction?
page-reason = Reason
page-roll-back = Roll back to this
page-sentence-no_effect = The plain model explains these runs down to the noise.
page-sentence-not_described = The model is too far from these runs for a verdict.
page-sentence-too_few_runs = Too few runs for a diagnosis.
page-sentence-unknown_effect = Something the catalogue does not know remains unexplained.
page-since-it-began = Since it began
page-suspected-causes = Suspected, not proven
page-version = Version
page-where = Where the plain model is wrong

## page: nights

page-night = Night
page-night-archive = { $archived } archived, { $freed } freed{ $removed ->
        [0] { "" }
       *[other] ; scans of { $removed } deleted
    }{ $later ->
        [0] { "" }
       *[other] ; { $later } follow
    }
page-night-blind = { $runs } without panel sensors
page-night-fitted = Fitted
page-night-later = { $runs } older ones follow in { $nights ->
        [one] the next night
       *[other] the next { $nights } nights
    }
page-night-left-out = Left out
page-night-memory = Memory
page-night-model = Model
page-night-named = Named
page-night-new = New
page-night-none = no model yet
page-night-not-asked = not asked: the same runs as the night before
page-night-not-fitted = { $runs } cannot be fitted
page-night-promoted = { $version } promoted
page-night-refused = { $version } rejected
page-night-report = Report of this night
page-night-standing = { $runs } fitted before
page-night-stays = { $version } stays
page-night-stored = { $runs } stored
page-night-took = Took
page-night-why = Why ({ $runs })
page-nights-hint = What the nightly job 'kerntemp refit' did for each press.
page-no-nights = No night yet: the nightly job 'kerntemp refit' has not run.

## page: access

page-access-hint = Reading on this machine needs no token. From elsewhere, and for every change, a token does: 'kerntemp token create'.
page-token = Access token
page-token-gone = Removed.
page-token-kept = Kept until this tab is closed.
page-use-token = Use for this tab

## page: everywhere

page-access = Access
page-ago = { $time } ago
page-alarms-more = { $count ->
        [one] 1 more alarm
       *[other] { $count } more alarms
    }
page-answer-not-known = not known
page-api-docs = API
page-back = Back
page-band95 = 95 % band
page-channels = Channels
page-chart-as-of = as of { $time }
page-chart-data = Numbers and downloads
page-chart-every = one row in { $step } is shown, the file has all
page-chart-high = upper bound
page-chart-keys = Arrow keys read values, with Shift they move the part shown; + and − zoom, 0 shows all again
page-chart-low = lower bound
page-chart-newer = Show newer
page-chart-wheel = To zoom, hold Ctrl and turn the wheel
page-chart-whole = Show all
page-choose-press = Press
page-core-predicted = Core, predicted
page-core-simulated = Core, simulated
page-core-temperature = Core temperature
page-could-not-load = This view could not be loaded.
page-date-unknown = unknown
page-day = Day
page-day-after = The day after
page-day-before = The day before
page-day-hint = Each point is the highest or lowest of all sensors in its step of time; a part you zoom into is read in finer steps. Lines bridge gaps of up to 10 min.
page-day-of = A day of the press { $press }
page-day-view = Whole days
page-day-whole = Whole day
page-field-no-number = { $key }: { $value } is no number
page-field-outside = { $key } = { $value }: must be a number from { NUMBER($lower) } to { NUMBER($upper) } { $unit }
page-files-only = no recorder, files only
page-follow = Follow
page-guide = Guide and reference
page-highest = highest
page-in-use = in use
page-interval = 95 % interval
page-language = Language
page-last-identifiable = last identifiable, { $run }
page-link-live = live
page-link-lost = no connection
page-link-waiting = connecting …
page-loading = loading …
page-lowest = lowest
page-material = Material
page-more = More
page-name = Name
page-nav-access = Access
page-nav-alarms = Alarms
page-nav-coefficients = Coefficients
page-nav-diagnosis = What the simulation gets wrong
page-nav-journal = Journal
page-nav-loggers = Loggers
page-nav-nights = Nights
page-nav-now = Press now
page-nav-presses = All presses
page-nav-runs = Runs
page-nav-wall = Wall view
page-need-token = Give an access token
page-needs-javascript = This page draws what the API answers and needs JavaScript.
page-next-by = by { $who }, { $time }
page-no-answer = The server does not answer.
page-no-reading-for = no reading for { $time }
page-no-reading-yet = no reading yet
page-no-readings = no readings
page-no-sign-of-life = No sign of life of { $process }; if it is not running, start kerntemp { $command }
page-panel-blister = blister
page-panel-good = good
page-panel-scrap = scrap
page-panel-undercured = undercured
page-peak-then = the core then peaks at { NUMBER($peak, maximumFractionDigits: 0) } °C
page-platens = Platens
page-quality = Quality
page-quality-bad_frame = bad frame
page-quality-good = good
page-quality-late = late
page-quality-missing = missing
page-quality-open = open wire
page-quality-over = over range
page-quality-simulated = simulated
page-quality-stale = stale
page-quality-under = under range
page-run = Run
page-run-closed = complete
page-run-damaged = damaged
page-run-interrupted = interrupted
page-run-open = running
page-save = Save
page-sensor-stray = not used, does not follow its face
page-sensors-bottom = Panel, bottom
page-sensors-top = Panel, top
page-skip = Skip to content
page-sort-by = Sort by
page-started = Time
page-state = State
page-state-idle = no panel
page-state-unknown = unknown
page-status = Status
page-suspected = Suspected cause
page-suspected-another-panel = another panel than in the header
page-suspected-sudden-change = a sudden change at the press or a sensor
page-target = Target
page-target-not-deciding = the resin's limits, not { NUMBER($target, maximumFractionDigits: 0) } °C
page-target-value = { NUMBER($target, maximumFractionDigits: 0) } °C
page-theme = Light or dark
page-thickness = Thickness
page-time-axis = Time [s]
page-time-from-closing = Time from closing [s]
page-unanswered = The server does not answer.
page-value = Value
page-verdict = Verdict
page-views = Views
page-what = What
page-when = When
