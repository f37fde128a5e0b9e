-- What the live sensor said of a run goes into a file beside that of its scans; of the core three numbers stay.
-- estimates_sha256 is '' of a run the sensor said nothing of, and empty of one whose estimates are in the store.
ALTER TABLE archive ADD COLUMN estimates_sha256 TEXT;
ALTER TABLE archive ADD COLUMN core_at_opening_celsius DOUBLE PRECISION;
ALTER TABLE archive ADD COLUMN core_band_kelvin DOUBLE PRECISION;
ALTER TABLE archive ADD COLUMN core_highest_celsius DOUBLE PRECISION;
