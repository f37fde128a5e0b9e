"""Files in and out: run files, mappings of other loggers, documents, manifests."""
