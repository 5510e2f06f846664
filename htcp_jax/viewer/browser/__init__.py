"""Viewer in the browser: a page with a 3D scene, a timeline, plots and display options, served by viser."""
