"""The estimators that ship with Beambench, by name."""

from __future__ import annotations

__all__ = ["BUILTIN", "WITHHELD"]

#: name -> "module:function"
BUILTIN: dict[str, str] = {
    "amcw-decade": "beambench.estimators.amcw.phase:amcw_decade",
    "amcw-ml": "beambench.estimators.amcw.ml:amcw_ml",
    "amcw-phase": "beambench.estimators.amcw.phase:amcw_phase",
    "chua-2017": "beambench.estimators.gated.chua_2017:chua_2017",
    "chua-2017-orthogonal": "beambench.estimators.gated.chua_2017:chua_2017_orthogonal",
    "constant-fraction": "beambench.estimators.gated.constant_fraction:constant_fraction",
    "gaussian-least-squares": "beambench.estimators.gated.gaussian_least_squares:gaussian_least_squares",
    "learned": "beambench.estimators.gated.learned:learned",
    "line-blais-rioux": "beambench.estimators.laser_line.blais_rioux:line_blais_rioux",
    "line-centroid": "beambench.estimators.laser_line.centroid:line_centroid",
    "line-erf": "beambench.estimators.laser_line.fits:line_erf",
    "line-log-gaussian": "beambench.estimators.laser_line.three_points:line_log_gaussian",
    "line-ml": "beambench.estimators.laser_line.fits:line_ml",
    "line-parabola": "beambench.estimators.laser_line.three_points:line_parabola",
    "line-peak": "beambench.estimators.laser_line.peak:line_peak",
    "line-steger": "beambench.estimators.laser_line.steger:line_steger",
    "line-window-centroid": "beambench.estimators.laser_line.centroid:line_window_centroid",
    "log-gaussian": "beambench.estimators.gated.log_gaussian:log_gaussian",
    "matched-filter": "beambench.estimators.gated.matched_filter:matched_filter",
    "parabola": "beambench.estimators.gated.parabola:parabola",
    "peak": "beambench.estimators.gated.peak:peak",
    "poisson-ml": "beambench.estimators.gated.poisson_ml:poisson_ml",
    "poisson-ml-backscatter": "beambench.estimators.gated.poisson_ml_backscatter:poisson_ml_backscatter",
    "poisson-ml-two-returns": "beambench.estimators.gated.poisson_ml_two_returns:poisson_ml_two_returns",
    "radiometric-average": "beambench.estimators.gated.radiometric_average:radiometric_average",
    "range-intensity-correlation": "beambench.estimators.gated.range_intensity:range_intensity_correlation",
    "slope-cell": "beambench.estimators.wavefront.slopes:slope_cell",
    "spot-brightest": "beambench.estimators.wavefront.moments:spot_brightest",
    "spot-centroid": "beambench.estimators.wavefront.moments:spot_centroid",
    "spot-correlation": "beambench.estimators.wavefront.correlations:spot_correlation",
    "spot-gaussian": "beambench.estimators.wavefront.fits:spot_gaussian",
    "spot-joint": "beambench.estimators.wavefront.fits:spot_joint",
    "spot-matched": "beambench.estimators.wavefront.correlations:spot_matched",
    "spot-ml": "beambench.estimators.wavefront.fits:spot_ml",
    "spot-power": "beambench.estimators.wavefront.moments:spot_power",
    "spot-quad": "beambench.estimators.wavefront.moments:spot_quad",
    "spot-threshold": "beambench.estimators.wavefront.moments:spot_threshold",
    "spot-weighted": "beambench.estimators.wavefront.moments:spot_weighted",
    "spot-window": "beambench.estimators.wavefront.moments:spot_window",
    "threshold": "beambench.estimators.gated.threshold:threshold",
    "triangulate-air": "beambench.estimators.laser_line.triangulate:triangulate_air",
    "triangulate-pinhole-port": "beambench.estimators.laser_line.triangulate:triangulate_pinhole_port",
    "triangulate-refractive": "beambench.estimators.laser_line.triangulate:triangulate_refractive",
    "waveform-average": "beambench.estimators.waveform.average:waveform_average",
    "waveform-coates": "beambench.estimators.waveform.average:waveform_coates",
    "waveform-constant-fraction": "beambench.estimators.waveform.fraction:waveform_constant_fraction",
    "waveform-counter": "beambench.estimators.waveform.edge:waveform_counter",
    "waveform-first-return": "beambench.estimators.waveform.fraction:waveform_first_return",
    "waveform-gaussian": "beambench.estimators.waveform.gaussian:waveform_gaussian",
    "waveform-leading-edge": "beambench.estimators.waveform.edge:waveform_leading_edge",
    "waveform-matched": "beambench.estimators.waveform.ml:waveform_matched",
    "waveform-ml": "beambench.estimators.waveform.ml:waveform_ml",
    "waveform-several-returns": "beambench.estimators.waveform.returns:waveform_several_returns",
    "weighted-average": "beambench.estimators.gated.weighted_average:weighted_average",
    "zernike-ls": "beambench.estimators.wavefront.modal:zernike_ls",
    "zernike-map": "beambench.estimators.wavefront.prior:zernike_map",
    "zonal-fried": "beambench.estimators.wavefront.zonal:zonal_fried",
    "zonal-southwell": "beambench.estimators.wavefront.zonal:zonal_southwell",
}

#: Names of published estimators that are not built, and of ours that had them: name -> (why, the name that ours has now).
WITHHELD: dict[str, tuple[str, str]] = {
    "chua-2016": (
        "The estimator of Chua et al. 2016 (J. Eur. Opt. Soc. Rapid Publ. 11:16015) is not built: the formula of its weights, "
        "from detection threshold and system noise, is not known to this project.",
        "radiometric-average",
    ),
}
