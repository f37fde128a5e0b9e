-- What is said of the panels to come at a press; a run begins with it.
CREATE TABLE next_panel (
    press TEXT PRIMARY KEY,
    unix_s DOUBLE PRECISION NOT NULL,
    who TEXT NOT NULL,
    recipe TEXT NOT NULL,  -- empty without one
    header_toml TEXT NOT NULL  -- header keys as in a run file, one TOML line each
);

-- Header keys kept under a name, to be chosen for the next panel.
CREATE TABLE recipe (
    name TEXT PRIMARY KEY,
    header_toml TEXT NOT NULL
);
