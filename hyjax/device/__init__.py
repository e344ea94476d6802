"""Relighting on a graphics processor: WebGPU shaders generated from a schedule, for Python and browsers."""
