"""Programs that read one foreign file each, in a process with little to do harm with.

They are run as files, so that they import nothing of ours but :mod:`confined` beside them. The file
is their standard input; their standard output begins with a message, see :func:`confined.say`.
"""
