-- Up to which scan of a press all that lies outside runs is thinned: so far nobody goes through it again.
CREATE TABLE idle_thinned (
    press_id BIGINT PRIMARY KEY REFERENCES press (press_id),
    number BIGINT NOT NULL
);
