-- Runs whose scans are in a Parquet file of the archive and no longer in scan; a row and the deletion are one commit.
CREATE TABLE archive (
    run TEXT PRIMARY KEY REFERENCES run (run),
    file TEXT NOT NULL,  -- below the archive's folder; empty once it is deleted
    sha256 TEXT NOT NULL,
    bytes BIGINT NOT NULL,
    scans BIGINT NOT NULL,
    layouts_json TEXT NOT NULL,  -- the channel layouts of these scans, as a list of their numbers
    archived_unix_s DOUBLE PRECISION NOT NULL,
    checked_unix_s DOUBLE PRECISION NOT NULL,  -- when the file was last read and had its sum
    problem TEXT NOT NULL,  -- missing, damaged, unreadable; empty while the file is sound
    removed_unix_s DOUBLE PRECISION  -- when the scans were given up by rule; empty while they are kept
);
CREATE INDEX archive_by_check ON archive (checked_unix_s) WHERE removed_unix_s IS NULL;
CREATE INDEX archive_unsound ON archive (run) WHERE problem <> '';
CREATE INDEX archive_leaving ON archive (run) WHERE removed_unix_s IS NOT NULL AND file <> '';

-- Where the archive is and what it holds in all: one row.
CREATE TABLE archive_total (
    place BIGINT PRIMARY KEY CHECK (place = 1),
    folder TEXT NOT NULL,
    runs BIGINT NOT NULL,
    scans BIGINT NOT NULL,
    bytes BIGINT NOT NULL,
    removed BIGINT NOT NULL
);
