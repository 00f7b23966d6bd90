"""DICOM radiographs: what is in a file, checked and decoded, and files written (docs/radiographs.md)."""
