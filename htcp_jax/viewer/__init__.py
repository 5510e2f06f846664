"""Pictures and movies of plans, and the page in the browser.

`picture` draws a workcell in 2D, `render` makes pictures, GIFs and movies, `browser` serves the page with timeline
and plots; `access` restricts who may open it.
"""
