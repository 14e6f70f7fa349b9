"""Starts each Python without what only POSIX has, as far as the code under test can tell.

Python loads this module before anything else where its folder is on the path, in each process that a test starts, too:

    PYTHONPATH=tests/as_on_windows python -m pytest

The standard library, and the packages whose task it is to know the platform, keep what they need.
"""

import asyncio
import concurrent.futures
import getpass
import logging.handlers
import multiprocessing.connection
import multiprocessing.popen_spawn_posix as _started_processes
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import types

import filelock
import psutil

_MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty")
_LACKING = {
    os: (
        "chown", "fchown", "fork", "forkpty", "getpgid", "getsid", "killpg", "mkfifo", "nice", "sched_getaffinity",
        "sched_setaffinity", "setpgid", "setsid", "wait3", "wait4", "WIFSIGNALED", "WTERMSIG",
    ),
    signal: (
        "SIGALRM", "SIGCHLD", "SIGCONT", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGSTOP", "SIGUSR1", "SIGUSR2",
        "alarm", "pause", "pthread_kill", "pthread_sigmask", "setitimer", "siginterrupt",
    ),
}  # fmt: skip
# Imported above so that they have the whole of it.
_KNOW_THE_PLATFORM = (
    asyncio, concurrent.futures, filelock, getpass, logging.handlers, multiprocessing, pathlib, psutil, shutil, subprocess, tempfile,
    _started_processes,
)  # fmt: skip

for _module, _names in _LACKING.items():
    _copy = types.ModuleType(_module.__name__)
    _copy.__dict__.update({key: value for key, value in _module.__dict__.items() if key not in _names})
    sys.modules[_module.__name__] = _copy
for _name in _MODULES:
    # Which is how to say that there is none.
    sys.modules[_name] = None  # type: ignore[assignment]
