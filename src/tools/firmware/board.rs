//! The boards that a plan is run on, all emulated.

use clap::ValueEnum;

/// A microcontroller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Board {
    /// Cortex-M4 with a floating-point unit (mps2-an386)
    #[value(name = "cortex-m4f")]
    CortexM4f,
    /// Cortex-M7 (mps2-an500)
    #[value(name = "cortex-m7")]
    CortexM7,
    /// Cortex-M3 without a floating-point unit (mps2-an385)
    #[value(name = "cortex-m3")]
    CortexM3,
    /// Cortex-M0 of the micro:bit: 256 KB of flash, 16 KB of RAM
    #[value(name = "cortex-m0")]
    CortexM0,
    /// RISC-V of 32 bits without a floating-point unit (virt)
    #[value(name = "rv32imc")]
    Rv32imc,
    /// RISC-V of 32 bits with a floating-point unit (virt)
    #[value(name = "rv32imafc")]
    Rv32imafc,
}

/// What is built for a board, and what runs it.
pub(crate) struct Machine {
    /// The compiler's name of the target.
    pub(crate) target: &'static str,
    /// The linker script in `boards/`.
    pub(crate) script: &'static str,
    /// The emulator, with the arguments that make it this board. Each instruction takes the same time.
    pub(crate) emulator: &'static [&'static str],
    /// The package that brings the emulator.
    pub(crate) package: &'static str,
    /// Whether it has the DSP extension, for which weights of int8 are laid out.
    pub(crate) has_dsp: bool,
}

impl Board {
    /// The board's name, as the command line has it.
    pub(crate) fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    pub(crate) fn machine(self) -> Machine {
        let arm = |target, script, emulator| Machine {
            target,
            script,
            emulator,
            package: "qemu-system-arm",
            has_dsp: matches!(self, Self::CortexM4f | Self::CortexM7),
        };
        let riscv = |target| Machine {
            target,
            script: "virt.ld",
            emulator: &["qemu-system-riscv32", "-M", "virt", "-bios", "none", "-icount", "shift=0"],
            package: "qemu-system-misc",
            has_dsp: false,
        };
        // Of eight nanoseconds each, 24 bits of the timer are enough for 80 million instructions.
        match self {
            Self::CortexM4f => {
                let emulator = &["qemu-system-arm", "-M", "mps2-an386", "-icount", "shift=3"];
                arm("thumbv7em-none-eabihf", "mps2.ld", emulator)
            }
            Self::CortexM7 => {
                let emulator = &["qemu-system-arm", "-M", "mps2-an500", "-icount", "shift=3"];
                arm("thumbv7em-none-eabihf", "mps2.ld", emulator)
            }
            Self::CortexM3 => {
                let emulator = &["qemu-system-arm", "-M", "mps2-an385", "-icount", "shift=3"];
                arm("thumbv7m-none-eabi", "mps2.ld", emulator)
            }
            Self::CortexM0 => {
                let emulator = &["qemu-system-arm", "-M", "microbit", "-icount", "shift=3"];
                arm("thumbv6m-none-eabi", "microbit.ld", emulator)
            }
            Self::Rv32imc => riscv("riscv32imc-unknown-none-elf"),
            Self::Rv32imafc => riscv("riscv32imafc-unknown-none-elf"),
        }
    }
}
