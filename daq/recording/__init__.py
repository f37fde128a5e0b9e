"""The recorder: scans from loggers, one line a press, runs that begin and end."""
