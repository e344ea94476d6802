"""The one exception that means "the input is wrong", so that the command line can tell it from a bug."""


class InputError(ValueError):
    """Something given to hyjax cannot be used.

    The message is one line that says what is wrong, where, and what would be right.
    """
