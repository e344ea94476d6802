"""The frame on a graphics processor: WebGPU shaders generated from a schedule, run from Python or in a browser."""
