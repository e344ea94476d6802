"""Pictures with depth to train and evaluate guides: one file per format."""
