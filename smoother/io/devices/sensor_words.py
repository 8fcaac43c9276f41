"""Words for time, specific force and angular velocity as programs in several languages write them."""

from __future__ import annotations

#: All in lower case; English first.
TIME_WORDS = ("time", "zeit", "zeitstempel", "temps", "tiempo", "tempo")
ACCELERATION_WORDS = (
    *("acceleration", "accelerometer", "beschleunigung", "beschleunigungssensor"),
    *("accélération", "aceleración", "accelerazione"),
)
LINEAR_WORDS = (
    *("linear acceleration", "lineare beschleunigung", "accélération linéaire", "aceleración lineal"),
)
TURNING_WORDS = (
    *("gyroscope", "gyroscope rotation", "rotation rate", "angular velocity"),
    *("gyroskop", "drehrate", "drehgeschwindigkeit", "winkelgeschwindigkeit"),
    *("giroscopio", "velocidad angular", "velocità angolare", "vitesse angulaire"),
)
