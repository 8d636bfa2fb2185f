"""Closing the loop: residual of the bias model, physical effect behind it, error before and after.

``inputs`` reads dwell tables and joins several to one ``campaign``; ``plausibility`` detects wrong columns.
``temperature_record`` and ``thermal_network`` give the temperatures between the dwells. ``problem`` is the
least-squares problem of the declared model, ``candidates`` fits ``effects`` to it, and ``search`` finds the
sets of effects that may explain the residual. ``evidence`` gives the ``posterior`` probability of each set,
with and without a ``remainder`` from an unlisted effect; ``selection`` selects one, with the ``noise``
estimated for it. ``compose`` searches for a law if no effect explains the residual, and ``confounding``
states what the campaign can't distinguish. ``validation``, ``held_out`` and ``uncertainty`` test the model.

``loop`` does all this. Its ``outcome``, for gyro biases or another ``quantity``, is written to ``files``;
``loadable_model`` is the part of it that an INS can subtract.

Before a measurement, ``planned_campaign`` predicts the dwells of a plan, with temperatures by
``unit_thermal``; ``separability`` states which effects they would show, ``tie_forecast`` which ties of an
earlier search they would resolve, and ``procedure_changes`` the smallest change of the procedure that helps.
"""
