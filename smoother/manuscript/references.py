"""What a methods section may cite; a DOI only where it is known for certain."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Reference:
    """A source.

    Attributes
    ----------
    key : str
        As sentences cite it: "[@key]".
    text : str
        Authors, title, journal, year.
    doi, url : str
        "" where there is none, or none that is certain.
    """

    key: str
    text: str
    doi: str = ""
    url: str = ""


REFERENCES = {
    each.key: each
    for each in (
        Reference("unocclude", "the unocclude contributors. unocclude (software), version {version}."),
        Reference(
            "gtsam", "F. Dellaert and GTSAM contributors. GTSAM.", url="https://github.com/borglab/gtsam"
        ),
        Reference(
            "forster2017",
            "C. Forster, L. Carlone, F. Dellaert, D. Scaramuzza. On-manifold preintegration for real-time"
            " visual-inertial odometry. IEEE Transactions on Robotics 33(1), 2017.",
            "10.1109/TRO.2016.2597321",
        ),
        Reference(
            "laidig2023",
            "D. Laidig, T. Seel. VQF: highly accurate IMU orientation estimation with bias estimation and"
            " magnetic disturbance rejection. Information Fusion 91, 2023.",
            "10.1016/j.inffus.2022.10.014",
        ),
        Reference(
            "wu2005",
            "G. Wu et al. ISB recommendation on definitions of joint coordinate systems of various joints for"
            " the reporting of human joint motion, part II: shoulder, elbow, wrist and hand. Journal of"
            " Biomechanics 38(5), 2005.",
            "10.1016/j.jbiomech.2004.05.042",
        ),
        Reference(
            "cereatti2024",
            "A. Cereatti et al. ISB recommendations on the definition, estimation, and reporting of joint"
            " kinematics in human motion analysis applications using wearable inertial measurement"
            " technology. Journal of Biomechanics 173, 2024.",
            "10.1016/j.jbiomech.2024.112225",
        ),
        Reference(
            "jatesiktat2017",
            "P. Jatesiktat, W. T. Ang. Recovery of forearm occluded trajectory in Kinect using a"
            " wrist-mounted inertial measurement unit. EMBC, 2017.",
        ),
        Reference(
            "bell1994",
            "B. M. Bell. The iterated Kalman smoother as a Gauss-Newton method. SIAM"
            " Journal on Optimization, 1994.",
        ),
        Reference("tian2015", "Tian et al. Neurocomputing, 2015 (unscented Kalman filter)."),
        Reference("feng2014", "Feng. Thesis, University of Glasgow, 2014."),
        Reference("le2017", "Le. Thesis, Texas A&M University, 2017."),
        Reference(
            "fritsch1980",
            "F. N. Fritsch, R. E. Carlson. Monotone piecewise cubic interpolation. SIAM"
            " Journal on Numerical Analysis 17, 1980.",
        ),
        Reference("madgwick2010", "S. O. H. Madgwick. Report (orientation filter), 2010."),
        Reference("comotti2013", "Comotti. 2013 (orientation filter)."),
    )
}
#: Orientation filters of the methods beside the graph, and whose.
ORIENTATION_WORDS = {
    "vqf": "VQF [@laidig2023]",
    "madgwick": "Madgwick's [@madgwick2010]",
    "comotti": "Comotti's [@comotti2013]",
    "complementary": "a complementary filter [@feng2014]",
}
