"""The composition: scenes, clips, training, metrics, experiments, records, command line."""
