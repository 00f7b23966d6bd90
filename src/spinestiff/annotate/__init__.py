"""Annotation of radiographs in the browser (paper 2.2): a page on loopback and what stands behind it."""
