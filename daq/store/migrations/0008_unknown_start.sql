-- A file need not say when its run was: then started_unix_s is empty.
DROP VIEW run_overview;
DROP VIEW coefficient_history;
DROP INDEX run_by_start;
ALTER TABLE run ADD COLUMN began DOUBLE PRECISION;
UPDATE run SET began = started_unix_s;
ALTER TABLE run DROP COLUMN started_unix_s;
ALTER TABLE run RENAME COLUMN began TO started_unix_s;
CREATE INDEX run_by_start ON run ((coalesce(started_unix_s, -1.0)));

-- Runs for people: names and times instead of numbers; started_utc is empty where nobody said when a run was.
CREATE VIEW run_overview AS
SELECT run.run, press.name AS press, press.kind, run.status, {utc run.started_unix_s} AS started_utc,
       run.inserted_s, run.closed_s, run.opened_s, run.removed_s,
       run.panel_material, run.panel_thickness_mm, run.remark, run.software_version
FROM run JOIN press ON press.press_id = run.press_id;

-- Heat transfer coefficients of every fit of every run, with their 95 % interval; the newest fit of a run counts.
CREATE VIEW coefficient_history AS
SELECT fit.run, {utc run.started_unix_s} AS started_utc, coefficient.name, coefficient.value_w_m2k,
       coefficient.sd_w_m2k, coefficient.low_w_m2k, coefficient.high_w_m2k, coefficient.identifiable,
       fit.model_version, {utc fit.created_unix_s} AS fitted_utc, fit.fit_id
FROM coefficient JOIN fit ON fit.fit_id = coefficient.fit_id JOIN run ON run.run = fit.run;
