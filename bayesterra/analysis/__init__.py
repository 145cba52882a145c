"""The main job: a study in, a result folder with its report out; simulation, and results side by side."""
