"""The STM32F4 of the board, emulated: the image that would be flashed, over the virtual plant. For tests and trials.

Unicorn executes the instructions. `chip` adds exceptions, sleep, resets and memory protection to it, `registers` and
`callbacks` what the program reads and writes; `wiring` does once a millisecond what takes time, `pins`, `edges`,
`converters`, `dma` and `line` part by part, over the plant and the `circuit` between; `loop` runs chip and machine
by turns, and `controller` is the whole as a controller of the simulator.

Sections cited are those of ST's reference manual RM0090 (peripherals) and programming manual PM0214 (core). Time
counts executed halfwords, one a clock: deterministic, not true to the cycle. What else is not modelled stands in
docs/firmware.md. edmctl loads this folder as `firmware_sim` (edmctl/board/emulated.py); no package carries it.
"""
