"""Sources whose title or DOI was looked up, as fields of BibTeX entries.

A source is found by a few words that its reference holds. A DOI stands here only if a published list of references gives it beside
the same authors, journal and page; none is written from memory. What is not here keeps the free form of its reference.
"""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["KNOWN", "PRODUCT", "source_of"]

#: Beambench itself.
PRODUCT: Mapping[str, str] = {
    "author": "{The Beambench developers}",
    "title": "Beambench: synthetic captures of active optical sensors with exact truth, and their benchmark",
}

_PROC = "Proceedings of the IEEE"
_PAMI = "IEEE Transactions on Pattern Analysis and Machine Intelligence"
_MNRAS = "Monthly Notices of the Royal Astronomical Society"

#: Words of a reference -> fields.
KNOWN: Mapping[str, Mapping[str, str]] = {
    "Guo et al. 2017": {
        "entry": "techreport",
        "author": "Guo, Anthony Ningqun and Wang, Xin and Chew, Kuew Wai and Tan, Ching Seong and Chang, Shoou-Jinn",
        "title": "Investigate Target Reflection and Illumination Sensitivity in Range Gated Detection",
        "institution": "Monash University Malaysia",
        "kind": "Final report",
    },
    "Kusters 1992": {
        "entry": "mastersthesis",
        "author": "Kusters, John Gerald, Jr.",
        "title": "Analysis and Application of an Underwater Optical-Ranging System",
        "school": "Massachusetts Institute of Technology and Woods Hole Oceanographic Institution",
    },
    "Sensors 17(9):2031": {
        "author": "Chua, Sing Yee and Guo, Ningqun and Tan, Ching Seong and Wang, Xin",
        "title": "Improved Range Estimation Model for Three-Dimensional (3D) Range Gated Reconstruction",
        "journal": "Sensors",
        "volume": "17",
        "number": "9",
        "pages": "2031",
    },
    "JOSA 70:998": {
        "title": "Wave-front estimation from wave-front slope measurements",
        "journal": "Journal of the Optical Society of America",
        "volume": "70",
        "pages": "998--1006",
        "doi": "10.1364/JOSA.70.000998",
    },
    "JOSA 73:1771": {
        "title": "Optimal wave-front correction using slope measurements",
        "journal": "Journal of the Optical Society of America",
        "volume": "73",
        "pages": "1771",
    },
    "MNRAS 371:323": {
        "title": "Comparison of centroid computation algorithms in a Shack-Hartmann sensor",
        "journal": _MNRAS,
        "volume": "371",
        "number": "1",
        "pages": "323--336",
        "doi": "10.1111/j.1365-2966.2006.10661.x",
    },
    "Appl. Opt. 42:5807": {
        "title": "Scene-based Shack-Hartmann wave-front sensing: analysis and simulation",
        "journal": "Applied Optics",
        "volume": "42",
        "number": "29",
        "pages": "5807--5815",
    },
    "Opt. Express 15:5147": {
        "title": "Iteratively weighted centroiding for Shack-Hartmann wave-front sensors",
        "journal": "Optics Express",
        "volume": "15",
        "number": "8",
        "pages": "5147",
    },
    "A&A 443:357": {
        "journal": "Astronomy and Astrophysics",
        "volume": "443",
        "pages": "357--365",
        "doi": "10.1051/0004-6361:20042188",
    },
    "PASP 112:1360": {
        "title": "Toward High-Precision Astrometry with WFPC2. I. Deriving an Accurate Point-Spread Function",
        "journal": "Publications of the Astronomical Society of the Pacific",
        "volume": "112",
        "pages": "1360--1382",
        "doi": "10.1086/316632",
    },
    "Intelligence 20:113": {
        "title": "An unbiased detector of curvilinear structures",
        "journal": _PAMI,
        "volume": "20",
        "number": "2",
        "pages": "113--125",
        "doi": "10.1109/34.659930",
    },
    "TPAMI 22:1330": {
        "title": "A flexible new technique for camera calibration",
        "journal": _PAMI,
        "volume": "22",
        "number": "11",
        "pages": "1330--1334",
        "doi": "10.1109/34.888718",
    },
    "CVPR 2012, p. 3346": {
        "entry": "inproceedings",
        "title": "A theory of multi-layer flat refractive geometry",
        "booktitle": "IEEE Conference on Computer Vision and Pattern Recognition",
        "pages": "3346--3353",
        "doi": "10.1109/CVPR.2012.6248073",
    },
    "Photogramm. 60:100": {
        "title": "Gaussian decomposition and calibration of a novel small-footprint full-waveform digitising airborne laser "
        "scanner",
        "journal": "ISPRS Journal of Photogrammetry and Remote Sensing",
        "volume": "60",
        "number": "2",
        "pages": "100--112",
        "doi": "10.1016/j.isprsjprs.2005.12.001",
    },
    "Inf. Theory 6:311": {
        "title": "An introduction to matched filters",
        "journal": "IRE Transactions on Information Theory",
        "volume": "6",
        "number": "3",
        "pages": "311--329",
        "doi": "10.1109/TIT.1960.1057571",
    },
    "Ann. Math. Stat. 9:60": {
        "title": "The large-sample distribution of the likelihood ratio for testing composite hypotheses",
        "journal": "The Annals of Mathematical Statistics",
        "volume": "9",
        "number": "1",
        "pages": "60--62",
        "doi": "10.1214/aoms/1177732360",
    },
    "Biometrika 61:439": {
        "title": "Quasi-likelihood functions, generalized linear models, and the Gauss-Newton method",
        "journal": "Biometrika",
        "volume": "61",
        "number": "3",
        "pages": "439--447",
        "doi": "10.1093/biomet/61.3.439",
    },
    "Water Resources Research 19:909": {
        "journal": "Water Resources Research",
        "volume": "19",
        "pages": "909",
        "doi": "10.1029/WR019i004p00909",
    },
    "Neurocomputing 70:489": {
        "title": "Extreme learning machine: theory and applications",
        "journal": "Neurocomputing",
        "volume": "70",
        "number": "1--3",
        "pages": "489--501",
        "doi": "10.1016/j.neucom.2005.12.126",
    },
    "Astrophysical Journal 263:835": {
        "title": "Studies in astronomical time series analysis. II. Statistical aspects of spectral analysis of unevenly spaced "
        "data",
        "journal": "The Astrophysical Journal",
        "volume": "263",
        "pages": "835--853",
        "doi": "10.1086/160554",
    },
    "Proc. IEEE 70:1055": {
        "title": "Spectrum estimation and harmonic analysis",
        "journal": _PROC,
        "volume": "70",
        "number": "9",
        "pages": "1055--1096",
        "doi": "10.1109/PROC.1982.12433",
    },
    "Proc. IEEE 66:51": {
        "title": "On the use of windows for harmonic analysis with the discrete Fourier transform",
        "journal": _PROC,
        "volume": "66",
        "number": "1",
        "pages": "51--83",
        "doi": "10.1109/PROC.1978.10837",
    },
    "Matematik 2:423": {
        "title": "Estimation and information in stationary time series",
        "journal": 'Arkiv f{\\"o}r Matematik',
        "volume": "2",
        "number": "5",
        "pages": "423--434",
        "doi": "10.1007/BF02590998",
    },
    "Signal Processing 11:145": {
        "title": "Real-time numerical peak detector",
        "journal": "Signal Processing",
        "volume": "11",
        "number": "2",
        "pages": "145--155",
        "doi": "10.1016/0165-1684(86)90033-2",
    },
    "Imaging Vis. 40:120": {
        "title": "A first-order primal-dual algorithm for convex problems with applications to imaging",
        "journal": "Journal of Mathematical Imaging and Vision",
        "volume": "40",
        "number": "1",
        "pages": "120--145",
        "doi": "10.1007/s10851-010-0251-1",
    },
    "Sci. Instrum. 1:878": {
        "title": "The correction for photon `pile-up' in the measurement of radiative lifetimes",
        "journal": "Journal of Physics E: Scientific Instruments",
        "volume": "1",
        "pages": "878--879",
        "doi": "10.1088/0022-3735/1/8/437",
    },
    "Methods 55:377": {
        "title": "A constant fraction of pulse height trigger for optimum time resolution",
        "journal": "Nuclear Instruments and Methods",
        "volume": "55",
        "pages": "377--380",
    },
    "Appl. Opt. 43(24):4705": {
        "title": "Gated viewing and high-accuracy three-dimensional laser radar",
        "journal": "Applied Optics",
        "volume": "43",
        "number": "24",
        "pages": "4705--4710",
    },
    "Opt. Eng. 45(3):034301": {
        "title": "Long-range three-dimensional imaging using range-gated laser radar images",
        "journal": "Optical Engineering",
        "volume": "45",
        "number": "3",
        "pages": "034301",
        "doi": "10.1117/1.2183668",
    },
    "Opt. Lett. 32:3146": {
        "title": "Long-range three-dimensional active imaging with superresolution depth mapping",
        "journal": "Optics Letters",
        "volume": "32",
        "number": "21",
        "pages": "3146--3148",
    },
    "JOSA A 12:272": {
        "title": "Compensation for readout noise in CCD images",
        "journal": "Journal of the Optical Society of America A",
        "volume": "12",
        "pages": "272--283",
    },
    "Int. Stat. Rev. 60:99": {
        "title": "Fisher's method of scoring",
        "journal": "International Statistical Review",
        "volume": "60",
        "pages": "99",
    },
    "Springer 1996, p. 385": {
        "entry": "incollection",
        "title": "A comparison of algorithms for subpixel peak detection",
        "booktitle": "Image Technology: Advances in Image Processing, Multimedia and Machine Vision",
        "publisher": "Springer",
        "pages": "385--404",
        "doi": "10.1007/978-3-642-58288-2_15",
    },
    "Math. 2:164": {
        "title": "A method for the solution of certain non-linear problems in least squares",
        "author": "Levenberg, Kenneth",
        "journal": "Quarterly of Applied Mathematics",
        "volume": "2",
        "number": "2",
        "pages": "164--168",
        "doi": "10.1090/qam/10666",
    },
    "SIAM 11:431": {
        "title": "An algorithm for least-squares estimation of nonlinear parameters",
        "author": "Marquardt, Donald W.",
        "journal": "Journal of the Society for Industrial and Applied Mathematics",
        "volume": "11",
        "number": "2",
        "pages": "431--441",
        "doi": "10.1137/0111030",
    },
}


def source_of(reference: str) -> Mapping[str, str]:
    """The known fields of a reference; none for a source that was not looked up."""
    return next((fields for words, fields in KNOWN.items() if words in reference), {})
