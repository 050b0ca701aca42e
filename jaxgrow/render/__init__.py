"""Still pictures of organs and growths, made without a display and GL.

Host code in plain numpy. Rays are cast with embreex if it is installed, else by our
z-buffer; nothing heavy is imported before a picture is drawn.
"""

from jaxgrow.render.figure import render_growth as render_growth
from jaxgrow.render.organ import render_surface as render_surface
