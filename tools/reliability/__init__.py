"""A second simulator, written apart from `smoother.simulation`, that judges the verdict of `smooth`.

`python -m tools.reliability --seed S --count N` draws unusual and wrong set-ups, smooths them as a user
would, and counts the gaps that are wrong and called trusted, and the sound ones that are not trusted.
"""
