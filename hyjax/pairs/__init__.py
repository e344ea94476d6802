"""Pictures with depth, which guides are trained and judged on: one file a format."""
