"""The strap looked for in a recording's images, and written into it as a joint."""
