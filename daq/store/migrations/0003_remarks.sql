-- What an imported file says in words beside a scan: its text columns, other than qualities.
CREATE TABLE scan_remark (
    press_id BIGINT NOT NULL,
    number BIGINT NOT NULL,
    texts_json TEXT NOT NULL,  -- JSON object column -> text, without empty ones
    PRIMARY KEY (press_id, number)
){clustered};
