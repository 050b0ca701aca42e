"""Still pictures of organs and growths, made without a display and without GL.

Host code in plain numpy. Rays are cast with embreex where it is installed and by an own
z-buffer where it is not; nothing heavy is imported before a picture is asked for.
"""

from jaxgrow.render.figure import render_growth as render_growth
from jaxgrow.render.organ import render_surface as render_surface
