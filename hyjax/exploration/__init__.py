"""Widget for notebooks: a scene's frames relit while choices and lights are changed by hand."""
