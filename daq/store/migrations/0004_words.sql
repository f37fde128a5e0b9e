-- What a journal line says as {"code", "arguments"}, put into words by daq/words; message says it in English.
ALTER TABLE event ADD COLUMN message_json TEXT;

-- Promotions of older versions are read back by the nightly job: they get their code too.
UPDATE event
SET message_json = '{"code":"model-promoted","arguments":{"version":"'
    || replace(replace(substr(message, 7, length(message) - 15), '\', '\\'), '"', '\"') || '"}}'
WHERE substr(message, 1, 6) = 'model ' AND substr(message, length(message) - 8) = ' promoted';
