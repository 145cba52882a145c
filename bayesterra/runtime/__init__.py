"""Files, folders, checkpoints, tasks and engines: what a long job needs of a machine."""
