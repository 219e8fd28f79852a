"""The STM32F4 of the board, emulated: the image that would be flashed, over the virtual plant. For tests and trials only.

Unicorn runs the instructions; `registers` models the peripherals, `wiring` what they are wired to, `chip` exceptions and
watchdogs, `controller` the whole as a controller of the simulator. Sections cited are those of ST's reference manual RM0090
(peripherals) and programming manual PM0214 (core). Time counts executed halfwords, one a clock: deterministic, not true
to the cycle.
"""
