"""One file an experiment. Each file's docstring gives its command, how long it takes and what to expect."""
