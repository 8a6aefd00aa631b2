"""`python -m scaleup`: what the launcher starts on every rank."""

import os
import sys

if not sys.flags.safe_path and sys.path[:1] == [os.getcwd()]:
    del sys.path[0]  # what lies in the working folder is not imported

from scaleup.cli import main

main()
