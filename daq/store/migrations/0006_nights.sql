-- What the nightly job did for one press in one night, and where the next one begins.
CREATE TABLE night (
    night_id {identity},
    press TEXT NOT NULL,
    started_unix_s DOUBLE PRECISION NOT NULL,
    ended_unix_s DOUBLE PRECISION NOT NULL,
    night_json TEXT NOT NULL,  -- runs new, fitted and left out, seconds, memory, named, promoted, refused
    progress_json TEXT NOT NULL  -- up to which run and which edit the press is done
);
CREATE INDEX night_by_press ON night (press, night_id);

-- Runs that have no fit: what was tried last, and why there is none.
CREATE TABLE unfitted (
    run TEXT PRIMARY KEY REFERENCES run (run),
    press TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('unfit', 'blind', 'killed')),
    fingerprint TEXT NOT NULL
);
CREATE INDEX unfitted_by_press ON unfitted (press, kind);
