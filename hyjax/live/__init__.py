"""Live rooms: frames arrive one by one, and surface, shadows and relit pictures follow."""
