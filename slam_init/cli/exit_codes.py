"""The exit codes of the commands; an interrupt gives 128 and the number of the signal."""

DONE, BAD_INPUT, NOT_INITIALIZED = 0, 2, 3
#: Added to the number of the signal.
INTERRUPTED = 128
