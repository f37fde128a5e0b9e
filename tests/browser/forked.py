"""Imported last by the process from which servers are forked: their collector need not look at all the rest."""

import gc

gc.collect()
gc.freeze()
