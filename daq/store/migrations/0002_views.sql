-- Units in the names of coefficients, and views that tell what belongs to which run and when.
DROP VIEW coefficient_history;
ALTER TABLE coefficient RENAME COLUMN value TO value_w_m2k;
ALTER TABLE coefficient RENAME COLUMN sd TO sd_w_m2k;
ALTER TABLE coefficient RENAME COLUMN low TO low_w_m2k;
ALTER TABLE coefficient RENAME COLUMN high TO high_w_m2k;

-- Heat transfer coefficients of every fit of every run, with their 95 % interval; the newest fit of a run counts.
CREATE VIEW coefficient_history AS
SELECT fit.run, {utc run.started_unix_s} AS started_utc, coefficient.name, coefficient.value_w_m2k,
       coefficient.sd_w_m2k, coefficient.low_w_m2k, coefficient.high_w_m2k, coefficient.identifiable,
       fit.model_version, {utc fit.created_unix_s} AS fitted_utc, fit.fit_id
FROM coefficient JOIN fit ON fit.fit_id = coefficient.fit_id JOIN run ON run.run = fit.run;

-- What the live sensor said in a run; give a run: SELECT * FROM run_estimate WHERE run = '...' ORDER BY time_s
CREATE VIEW run_estimate AS
SELECT run.run, estimate.number, estimate.monotonic_s - run.zero_monotonic_s AS time_s, estimate.state,
       estimate.core_celsius, estimate.core_sd_kelvin, estimate.core_low_celsius, estimate.core_high_celsius,
       estimate.valid, estimate.reason, estimate.model_version
FROM run
JOIN estimate ON estimate.press_id = run.press_id AND estimate.number >= run.first_scan
     AND (run.last_scan IS NULL OR estimate.number <= run.last_scan);

-- inserted, closed, opened, removed, in seconds of the run; give a run.
CREATE VIEW run_event AS
SELECT run.run, press_event.kind, press_event.monotonic_s - run.zero_monotonic_s AS time_s,
       {utc press_event.unix_s} AS utc, press_event.source
FROM run
JOIN press_event ON press_event.press_id = run.press_id AND press_event.scan_number >= run.first_scan
     AND (run.last_scan IS NULL OR press_event.scan_number <= run.last_scan);

-- Model versions with the time they were made.
CREATE VIEW model_overview AS
SELECT model.version, model.press, model.status, {utc model.created_unix_s} AS created_utc, model.reason,
       model.model_json
FROM model;

-- The journal with times to read.
CREATE VIEW journal AS
SELECT {utc event.unix_s} AS utc, event.level, event.process, event.press, event.message, event.detail_json
FROM event;
