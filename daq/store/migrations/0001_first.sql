-- A series of scans: one press as recorded here, or files imported for it. Numbers count up within a series.
CREATE TABLE press (
    press_id {identity},
    name TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('recorded', 'imported')),
    press_file TEXT NOT NULL,  -- TOML text, as last registered
    created_unix_s DOUBLE PRECISION NOT NULL,
    UNIQUE (name, kind)
);

-- What the positions in scan.readings mean; a new row whenever the channels of a press change.
CREATE TABLE channel_layout (
    layout_id {identity},
    press_id BIGINT NOT NULL REFERENCES press,
    columns_json TEXT NOT NULL,  -- [["top_1", "C"], ...]: name and unit of each position
    created_unix_s DOUBLE PRECISION NOT NULL
);

-- Raw data. Never changed; idle scans (outside every run) may be thinned by rule.
CREATE TABLE scan (
    press_id BIGINT NOT NULL REFERENCES press,
    number BIGINT NOT NULL,
    unix_s DOUBLE PRECISION,  -- UTC, seconds since 1970; empty for imported files
    monotonic_s DOUBLE PRECISION NOT NULL,  -- never set back; counts from an arbitrary start
    layout_id BIGINT NOT NULL REFERENCES channel_layout,
    readings TEXT NOT NULL,  -- JSON array in the order of the layout; null = no value
    faults TEXT,  -- JSON object column -> quality, for values that are not good; empty = all good
    PRIMARY KEY (press_id, number)
){clustered};

-- The settings a recorder ran with, once for each change.
CREATE TABLE configuration (
    configuration_id {identity},
    text TEXT NOT NULL UNIQUE,
    created_unix_s DOUBLE PRECISION NOT NULL
);

-- One pressing: the scans first_scan .. last_scan of its press. time_s of a row = monotonic_s - zero_monotonic_s.
CREATE TABLE run (
    run_number {identity},
    run TEXT NOT NULL UNIQUE,
    press_id BIGINT NOT NULL REFERENCES press,
    status TEXT NOT NULL CHECK (status IN ('open', 'closed', 'interrupted')),
    started_unix_s DOUBLE PRECISION NOT NULL,
    ended_unix_s DOUBLE PRECISION,
    zero_monotonic_s DOUBLE PRECISION NOT NULL,
    first_scan BIGINT NOT NULL,
    last_scan BIGINT,  -- empty while the run is open
    inserted_s DOUBLE PRECISION,  -- moments as the recorder found them, in seconds of the run
    closed_s DOUBLE PRECISION,
    opened_s DOUBLE PRECISION,
    removed_s DOUBLE PRECISION,
    panel_material TEXT,
    panel_thickness_mm DOUBLE PRECISION,
    header_toml TEXT NOT NULL,  -- all header keys of the run file, one TOML line each
    remark TEXT NOT NULL DEFAULT '',
    configuration_id BIGINT REFERENCES configuration,
    software_version TEXT NOT NULL
);
CREATE INDEX run_by_press ON run (press_id, first_scan);
CREATE INDEX run_by_status ON run (status, run_number);
CREATE INDEX run_by_start ON run (started_unix_s);

-- Who changed which header key or remark of a run, and what it was before.
CREATE TABLE run_change (
    run_change_id {identity},
    run TEXT NOT NULL REFERENCES run (run),
    unix_s DOUBLE PRECISION NOT NULL,
    who TEXT NOT NULL,
    field TEXT NOT NULL,
    before_toml TEXT,
    after_toml TEXT
);
CREATE INDEX run_change_by_run ON run_change (run);

-- inserted, closed, opened, removed
CREATE TABLE press_event (
    press_event_id {identity},
    press_id BIGINT NOT NULL REFERENCES press,
    kind TEXT NOT NULL,
    unix_s DOUBLE PRECISION,
    monotonic_s DOUBLE PRECISION NOT NULL,
    noticed_monotonic_s DOUBLE PRECISION NOT NULL,
    scan_number BIGINT NOT NULL,  -- the scan at which it was noticed
    source TEXT NOT NULL,
    UNIQUE (press_id, scan_number, kind)
);

-- What the live sensor said at each scan.
CREATE TABLE estimate (
    press_id BIGINT NOT NULL,
    number BIGINT NOT NULL,  -- the scan
    monotonic_s DOUBLE PRECISION NOT NULL,
    state TEXT NOT NULL,
    core_celsius DOUBLE PRECISION,
    core_sd_kelvin DOUBLE PRECISION,
    core_low_celsius DOUBLE PRECISION,
    core_high_celsius DOUBLE PRECISION,
    valid INTEGER NOT NULL,
    reason TEXT NOT NULL,
    model_version TEXT NOT NULL,
    detail_json TEXT,
    PRIMARY KEY (press_id, number)
){clustered};

-- The result of fitting one run; the newest row of a run counts.
CREATE TABLE fit (
    fit_id {identity},
    run TEXT NOT NULL REFERENCES run (run),
    created_unix_s DOUBLE PRECISION NOT NULL,
    model_version TEXT NOT NULL,
    converged INTEGER NOT NULL,
    rmse_kelvin DOUBLE PRECISION,
    fit_json TEXT NOT NULL
);
CREATE INDEX fit_by_run ON fit (run, fit_id);

CREATE TABLE coefficient (
    fit_id BIGINT NOT NULL REFERENCES fit,
    name TEXT NOT NULL,
    value DOUBLE PRECISION,
    sd DOUBLE PRECISION,
    low DOUBLE PRECISION,  -- 95 % interval
    high DOUBLE PRECISION,
    identifiable INTEGER NOT NULL,
    PRIMARY KEY (fit_id, name)
);
CREATE INDEX coefficient_by_name ON coefficient (name, fit_id);

-- Model versions; at most one of a press is promoted.
CREATE TABLE model (
    model_number {identity},
    version TEXT NOT NULL UNIQUE,
    press TEXT NOT NULL,
    created_unix_s DOUBLE PRECISION NOT NULL,
    status TEXT NOT NULL CHECK (status IN ('candidate', 'promoted', 'retired', 'rejected')),
    reason TEXT NOT NULL,
    model_json TEXT NOT NULL
);

CREATE TABLE diagnosis (
    diagnosis_id {identity},
    press TEXT NOT NULL,
    created_unix_s DOUBLE PRECISION NOT NULL,
    verdict TEXT NOT NULL,
    diagnosis_json TEXT NOT NULL
);

-- What happened: alarms, losses, changes of state, who did what.
CREATE TABLE event (
    event_id {identity},
    unix_s DOUBLE PRECISION NOT NULL,
    level TEXT NOT NULL CHECK (level IN ('info', 'warning', 'alarm')),
    process TEXT NOT NULL,
    press TEXT,
    message TEXT NOT NULL,
    detail_json TEXT
);

-- One row for each process: its newest sign of life.
CREATE TABLE status (
    process TEXT PRIMARY KEY,
    unix_s DOUBLE PRECISION NOT NULL,
    status_json TEXT NOT NULL
);

-- Runs for people: names and times instead of numbers.
CREATE VIEW run_overview AS
SELECT run.run, press.name AS press, press.kind, run.status, {utc run.started_unix_s} AS started_utc,
       run.inserted_s, run.closed_s, run.opened_s, run.removed_s,
       run.panel_material, run.panel_thickness_mm, run.remark, run.software_version
FROM run JOIN press ON press.press_id = run.press_id;

-- Scans of runs; give a run: SELECT * FROM run_scan WHERE run = '...' ORDER BY time_s
CREATE VIEW run_scan AS
SELECT run.run, scan.number, scan.monotonic_s - run.zero_monotonic_s AS time_s, {utc scan.unix_s} AS utc,
       layout.columns_json AS columns, scan.readings, scan.faults
FROM run
JOIN scan ON scan.press_id = run.press_id AND scan.number >= run.first_scan
     AND (run.last_scan IS NULL OR scan.number <= run.last_scan)
JOIN channel_layout AS layout ON layout.layout_id = scan.layout_id;

-- Every coefficient of every fit with its run.
CREATE VIEW coefficient_history AS
SELECT coefficient.name, fit.run, coefficient.value, coefficient.sd, coefficient.low, coefficient.high,
       coefficient.identifiable, fit.model_version, fit.fit_id
FROM coefficient JOIN fit ON fit.fit_id = coefficient.fit_id;
