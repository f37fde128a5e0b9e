-- The ways to people that some server over this store has: a new alarm goes by all of them, whoever raised it.
CREATE TABLE alarm_way (
    way TEXT PRIMARY KEY,  -- email, webhook
    seen_unix_s DOUBLE PRECISION NOT NULL  -- when a server that has it was last there
);
