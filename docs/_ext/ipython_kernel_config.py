"""The notebook's kernel: no word about its sockets, no colours in what commands print."""

c = get_config()  # noqa: F821  # IPython brings it
c.IPKernelApp.log_level = 40
c.IPKernelApp.exec_lines = ["import os; os.environ['FORCE_COLOR'] = ''"]
