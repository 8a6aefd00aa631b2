"""`python -m scaleup`: what the launcher starts on every rank."""

import os
import sys

if not sys.flags.safe_path and sys.path[:1] == [os.getcwd()]:
    del sys.path[0]  # what lies in the working folder is not imported
    del sys.modules["scaleup"]  # a folder of that name there may have become part of it

from scaleup.command.cli import main

main()
