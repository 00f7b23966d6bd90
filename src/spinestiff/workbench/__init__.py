"""The workbench: one page for subjects from radiographs to report, for people who never open a terminal."""
