"""Program of a small picture, by which a page finds out whether a device gets half precision right."""

from hyjax.core.schedule import Schedule
from hyjax.device.cascade_program import CascadeWriter
from hyjax.device.program import Groups, Precision, Program, columns_rows, grid_of

SIZE = 48, 64
"""(height, width) of the picture."""
_LIGHT = Groups(1)


def precision_check(precision: Precision) -> Program:
    """Cascade over a made-up picture; the buffer `result` holds what comes out, in single precision.

    There is one stage, `check`, and nothing to upload.
    """
    program = Program(SIZE, precision)
    guide, light = program.picture("guide", SIZE, Groups(1)), program.picture("light", SIZE, _LIGHT)
    constants: dict[str, object] = {"size": columns_rows(SIZE)}
    grid = grid_of(SIZE)
    program.launch("check", "pattern", ["pattern"], [guide, light], grid, _LIGHT, constants=constants)
    writer = CascadeWriter(program, guide, 3, "check")
    refined = writer.cascade("cascade", light, Schedule.preset("hyjax"), _LIGHT)
    shadows = writer.cascade("shadow pass", refined, Schedule.preset("hyjax-scan-shadow"), _LIGHT)
    result = program.buffer("result", 16 * SIZE[0] * SIZE[1], _LIGHT)
    program.launch("check", "result", ["unpacked"], [shadows, result], grid, _LIGHT, constants=constants)
    return program
