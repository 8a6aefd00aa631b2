"""Errors that a user can act on: each carries one sentence and no traceback is shown."""


class ScaleupError(Exception):
    """Base of all errors shown to the user as one sentence; `exit_code` is the process's."""

    exit_code = 1


class InputError(ScaleupError):
    """The user asked for something that cannot be: names key, value and rule."""

    exit_code = 2


class PluginError(InputError):
    """A plugin is unknown, ambiguous or broken: names it and its distribution."""


class ContractError(ScaleupError):
    """A plugin broke the contract it was written against: names the rule and the figure."""


class RunError(ScaleupError):
    """A computation could not be finished: says what, where and what to change."""


def file_error(error: OSError) -> RunError:
    """An error of the file system as one sentence: which file, and what is wrong."""
    return RunError(f"{error.filename or 'a file'}: {error.strerror or error}")
