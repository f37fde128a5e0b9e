-- A press's newest runs, without a walk through all of its own or of the others'.
CREATE INDEX run_by_number ON run (press_id, run_number);
