"""`python -m scaleup`: what the launcher starts on every rank."""

from scaleup.cli import main

main()
