"""What is missing as a free function: where no cause of the catalogue explains the runs, they show its law.

Read `kinds` (of what a law is, and by which variable), `fitting` (a kind fitted beside everything else), `curve`
(its band, and which known cause it is like), `choice` (whether there is a law, and which).

A law is a smooth function of one variable, a Gaussian process on a few knots with a squared-exponential kernel:
its weights are one more effect of the model, with independent normal priors, so coefficients, moments and offsets
are fitted beside it and derivatives are exact. How strong it is, the prior's standard deviation, is learned from
the campaign: the marginal likelihood (Laplace's, from the fit's curvature) over a grid.

=================  ===========================  =================================================================
kind               variable                     curve
=================  ===========================  =================================================================
``contact``        ``time_since_closing_s``     factor on the closed panel's contacts, 1 at the latest time seen;
                                                ``contact_lower`` and ``contact_upper`` on one of them alone, 1
                                                where it is the press's closed coefficient as the other is
``contact_by_load``  ``load_share``             factor on the closed panel's contacts by the pressure over its
                                                reference, 1 there; distinct only by pressures that change within
                                                a pressing, as each has contacts of its own
``conductivity``     ``temperature_C``          factor on the panel's conductivity
``contact_by_temperature``
                   ``temperature_C``            factor on the closed panel's contacts by the temperature of the
                                                face that each touches, 1 at the hottest seen
``heat``           ``temperature_C``            heat that goes for good as the panel warms up, negative where it
                                                comes [kJ/m³K]
``heat_exchange``  ``depth_share``              heat lost to the room by height in the panel, 0 at its lower face;
                                                negative where it comes [W/m³K]
``source_by_depth``  ``depth_share``            heat released in the closed press by height in the panel, negative
                                                where it is taken up [kW/m³]
``source_by_time``   ``time_since_closing_s``   the same, everywhere in the panel, by the time since closing
=================  ===========================  =================================================================

Runs left out decide: each, with the law from the others and its own contacts fitted, must be met better than
without a law, with an interval above nothing; for each the kind is chosen by the other runs. Kinds that these do
not distinguish from the best, or by less than counts as a pattern, form a set.

References
----------
Rasmussen & Williams, Gaussian Processes for Machine Learning (2006), sec. 8.3.1 (subset of regressors) and 3.4
(Laplace's approximation of the marginal likelihood).
"""
