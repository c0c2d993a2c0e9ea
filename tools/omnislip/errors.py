"""The error a user can mend."""


class InputError(Exception):
    """Input that cannot be used: one line naming file, line or key, and what would be right.

    The command line prints it and exits with status 2; any other exception is a defect of ours.
    """


class RobotError(Exception):
    """A robot that does not do what it was asked: one line saying what it did instead.

    The command line prints it and exits with status 3.
    """
