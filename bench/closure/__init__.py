"""Closing the loop: what the bias model leaves, the physical effect behind it, the error before and after.

``inputs`` reads dwell tables and joins several to one ``campaign``; ``plausibility`` finds columns that are
wrong. ``temperature_record`` and ``thermal_network`` are the temperatures between the dwells. ``problem`` is
the least-squares problem of the declared model,
``candidates`` fits ``effects`` to it, and ``search`` finds the sets of them that may explain the residual.
``evidence``, also beside a ``remainder`` that is on no list, gives the ``posterior`` probability of each set;
``selection`` takes one of them, in its own ``noise``. ``compose`` searches for a law where no effect explains
the residual, and ``confounding`` states what the campaign can't distinguish. ``validation``, ``held_out`` and
``uncertainty`` test the model.

``loop`` does all this; its ``outcome``, for gyro biases or another ``quantity``, is written to ``files``, and
``loadable_model`` is the part of it that an INS can subtract.

Before a measurement, ``planned_campaign`` has the dwells of a plan, with temperatures by ``unit_thermal``;
``separability`` states which effects they would show, ``tie_forecast`` what they would decide of an earlier
search, and ``procedure_changes`` the smallest change of the procedure that helps.
"""
