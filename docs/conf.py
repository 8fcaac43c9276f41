"""How the documents become a site: `make docs` builds them in out/site."""

import os
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
#: The notebook's kernel has a profile of its own: no start-up files of the person who builds.
PROFILE = HERE.parent / "out" / "ipython"
os.environ["IPYTHONDIR"] = str(PROFILE)
(PROFILE / "profile_default").mkdir(parents=True, exist_ok=True)
shutil.copy(HERE / "_ext" / "ipython_kernel_config.py", PROFILE / "profile_default")
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

from smoother import __version__  # noqa: E402

project = "unocclude"
author = copyright = "the unocclude contributors"
version = release = __version__

extensions = [
    "myst_nb",  # Markdown, and the notebook that is run at every build
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_design",
    "sphinx_copybutton",
    "written_at_build",  # _ext: commands, settings, and pages that no list names
]
exclude_patterns = ["_*"]
templates_path = ["_templates"]
highlight_language = "none"  # a block without a language is what a terminal shows

# Markdown as it stands: GitHub's anchors of headings, definition lists, ::: for directives
myst_enable_extensions = ["colon_fence", "deflist", "substitution"]
myst_heading_anchors = 4
suppress_warnings = ["misc.highlighting_failure"]  # examples of files leave cells out with ..

# the notebook: run anew, in a temporary folder; an error in it is an error of the build
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_merge_streams = True

autosummary_generate = True
autodoc_typehints = "none"  # docstrings say types, shapes and units
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
python_use_unqualified_type_names = True

html_theme = "pydata_sphinx_theme"
html_title = "unocclude"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "unocclude"},
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": ["licence"],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": []}
