"""The paper's equations on arrays: differences, diffusion, pyramid, cascade, schedules."""
