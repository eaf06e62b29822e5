#!/bin/sh
# Comments end at column 100. Comments, messages, help, manual and documents avoid the words of
# language.list. Commit subjects have at most 72 letters, from the commit that added this lint on;
# without git history (a tarball) they are not checked.
command -v python3 >/dev/null || {
    echo "language: python3 not found: comments and messages are not checked"
    exit 0
}
exec python3 tests/lint/language.py
