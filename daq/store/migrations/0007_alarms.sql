-- What somebody should know: one row from the moment it is noticed until it is over.
CREATE TABLE alarm (
    alarm_id {identity},
    key TEXT NOT NULL,  -- what it is about, the same as long as it stands
    press TEXT,
    message_json TEXT NOT NULL,
    raised_unix_s DOUBLE PRECISION NOT NULL,
    seen_unix_s DOUBLE PRECISION NOT NULL,  -- when it was last found to stand
    ended_unix_s DOUBLE PRECISION,  -- empty while it stands
    acknowledged_unix_s DOUBLE PRECISION,
    acknowledged_by TEXT
);
CREATE UNIQUE INDEX alarm_standing ON alarm (key) WHERE ended_unix_s IS NULL;

-- Outbox: an alarm on its way to somebody, made with the alarm itself.
CREATE TABLE alarm_delivery (
    alarm_id BIGINT NOT NULL REFERENCES alarm,
    way TEXT NOT NULL,  -- email, webhook
    due_unix_s DOUBLE PRECISION NOT NULL,  -- not before; put off while a process has it in hand
    tries BIGINT NOT NULL,
    delivered_unix_s DOUBLE PRECISION,  -- empty until the receiver has taken it
    problem TEXT NOT NULL,  -- why the last try failed
    PRIMARY KEY (alarm_id, way)
);
CREATE INDEX alarm_delivery_open ON alarm_delivery (due_unix_s) WHERE delivered_unix_s IS NULL;

-- Up to which line of the journal its alarms were taken up.
CREATE TABLE alarm_position (
    journal TEXT PRIMARY KEY,
    event_id BIGINT NOT NULL
);

-- Limits an engineer sets for a press.
CREATE TABLE alarm_threshold (
    press TEXT PRIMARY KEY,
    unix_s DOUBLE PRECISION NOT NULL,
    who TEXT NOT NULL,
    thresholds_json TEXT NOT NULL
);
