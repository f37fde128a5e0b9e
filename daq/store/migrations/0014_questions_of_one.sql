-- Questions about one press, or one kind of line, go through none of what the others have left in ten years.

-- The newest fit of each press that has one: neither its runs nor all fits are gone through for it.
CREATE TABLE newest_fit (
    press_id BIGINT PRIMARY KEY REFERENCES press (press_id),
    fit_id BIGINT NOT NULL REFERENCES fit (fit_id)
);
INSERT INTO newest_fit (press_id, fit_id)
SELECT run.press_id, max(fit.fit_id) FROM fit JOIN run ON run.run = fit.run GROUP BY run.press_id;

CREATE INDEX run_by_press_and_start ON run (press_id, (coalesce(started_unix_s, -1.0)), run_number);
CREATE INDEX press_event_by_press ON press_event (press_id, press_event_id);
CREATE INDEX model_by_press ON model (press, model_number);
CREATE INDEX model_in_force ON model (press) WHERE status = 'promoted';
CREATE INDEX diagnosis_by_press ON diagnosis (press, diagnosis_id);
CREATE INDEX event_by_level ON event (level, event_id);
CREATE INDEX event_by_press ON event (press, event_id);
CREATE INDEX event_by_process ON event (process, event_id);
CREATE INDEX event_by_time ON event (unix_s);
CREATE INDEX alarm_by_press ON alarm (press, alarm_id);
CREATE INDEX alarm_pending ON alarm (alarm_id) WHERE ended_unix_s IS NULL OR acknowledged_unix_s IS NULL;
