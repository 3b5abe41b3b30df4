//! What builds and runs programs for a board: found on this machine, or named as missing. Nothing is installed.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::{env, fs};

use clap::ValueEnum;
use sortie_bundle::{hex, sha256};
use sortie_cli::failure::{Exit, Failure, with_sources};
use sortie_cli::files::write_output;
use sortie_cli::output::tell;
use sortie_core::plan::Header;
use sortie_plans::for_dsp;

/// The oldest compiler that builds the runtime core.
const OLDEST: (u32, u32) = (1, 95);

/// A compiler with a library for the board, and an emulator of it.
pub(crate) struct Toolchain {
    /// The compiler's version.
    pub(crate) version: String,
    compiler: Compiler,
    emulator: PathBuf,
}

/// A program of the firmware, and what it is built around.
pub(crate) struct Program<'a> {
    pub(crate) name: &'static str,
    /// Features of the firmware that it needs.
    pub(crate) features: &'static [&'static str],
    /// Variables that name files, and what these hold.
    pub(crate) files: &'a [(&'static str, Vec<u8>)],
}

/// Where the library `core` of the target comes from.
enum Compiler {
    /// The toolchain has it: `rustup target add` brought it.
    Target,
    /// It is built from its sources by the compiler that they belong to.
    Sources { rustc: PathBuf, linker: PathBuf },
}

impl Toolchain {
    /// Looks for all that a board needs; `packaged` is a compiler with the sources of its library.
    pub(crate) fn find(machine: &Machine, packaged: &Path) -> Result<Self, Failure> {
        if in_path("cargo").is_none() {
            let message = "`cargo`, which builds firmware, is not installed: see https://rustup.rs";
            return Err(Failure::new(Exit::NotRunning, message));
        }
        let emulator = machine.emulator.split(' ').next().and_then(in_path);
        let mut missing = Vec::new();
        let rustc = Path::new("rustc");
        let compiler = if has_target(rustc, machine.target) {
            Some((Compiler::Target, version(rustc).unwrap_or_default()))
        } else {
            missing = missing_of(packaged);
            let linker = linker();
            if linker.is_none() {
                missing.push("lld");
            }
            linker.zip(version(packaged)).map(|(linker, version)| {
                (Compiler::Sources { rustc: packaged.to_owned(), linker }, version)
            })
        };
        if emulator.is_none() {
            missing.push(machine.package);
        }
        match (compiler, emulator) {
            (Some((compiler, version)), Some(emulator)) if missing.is_empty() => {
                Ok(Self { version, compiler, emulator })
            }
            _ => Err(not_installed(machine, &missing.join(" "))),
        }
    }

    /// Builds a program of the firmware in `sources`, and returns its file.
    pub(crate) fn build(
        &self,
        machine: &Machine,
        sources: &Path,
        program: &Program<'_>,
    ) -> Result<PathBuf, Failure> {
        let target = sources.join("../../target");
        let target = env::var_os("CARGO_TARGET_DIR").map_or(target, PathBuf::from).join("firmware");
        let boards = sources.join("boards");
        let mut flags = vec![
            format!("-Clink-arg=-L{}", boards.display()),
            format!("-Clink-arg=-T{}", machine.script),
        ];
        let mut cargo = Command::new("cargo");
        cargo.args(["build", "--release", "--locked", "--target", machine.target]);
        cargo.args(["--bin", program.name, "--features", &program.features.join(",")]);
        cargo.arg("--manifest-path").arg(sources.join("Cargo.toml"));
        cargo.arg("--target-dir").arg(&target);
        for (variable, content) in program.files {
            cargo.env(variable, kept(&target.join("plans"), &machine.laid_out(content)?)?);
        }
        if let Compiler::Sources { rustc, linker } = &self.compiler {
            flags.push(format!("-Clinker={}", linker.display()));
            // Unlocks the one flag of cargo: the firmware's packages use nothing that is unstable.
            cargo.arg("-Zbuild-std=core").env("RUSTC_BOOTSTRAP", "1").env("RUSTC", rustc);
        }
        cargo.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\u{1f}"));
        let output =
            cargo.stdin(Stdio::null()).output().map_err(|error| started("cargo", &error))?;
        if !output.status.success() {
            return Err(not_built(&String::from_utf8_lossy(&output.stderr)));
        }
        Ok(target.join(machine.target).join("release").join(program.name))
    }

    /// The emulator, which ends as the program does.
    pub(crate) fn emulator(&self, machine: &Machine, program: &Path) -> Command {
        let mut command = Command::new(&self.emulator);
        command.args(machine.emulator.split(' ').skip(1));
        command.args(["-semihosting-config", "enable=on,target=native", "-kernel"]);
        command.arg(program);
        command
    }
}

impl Machine {
    /// A file as this board reads it: a plan is laid out for the DSP extension where there is one.
    pub(crate) fn laid_out<'f>(&self, file: &'f [u8]) -> Result<Cow<'f, [u8]>, Failure> {
        if self.has_dsp && Header::read(file).is_ok() {
            return Ok(for_dsp(file)?.as_slice().to_vec().into());
        }
        Ok(file.into())
    }
}

/// Bytes as a file that is named by their content, so that what is built around it need not be built again.
fn kept(folder: &Path, bytes: &[u8]) -> Result<PathBuf, Failure> {
    let path = folder.join(format!("{}.plan", hex(&sha256(bytes))));
    if !path.exists() {
        fs::create_dir_all(folder).map_err(|error| Failure::file(folder, &error))?;
        write_output(&path, bytes)?;
    }
    // The compiler takes other paths from the file that names them.
    fs::canonicalize(&path).map_err(|error| Failure::file(&path, &error))
}

/// The packages that a compiler with sources needs and this machine does not have.
fn missing_of(packaged: &Path) -> Vec<&'static str> {
    let is_new = version(packaged).is_some_and(|version| is_new_enough(&version));
    let sources = printed(packaged, &["--print", "sysroot"])
        .map(|root| Path::new(&root).join("lib/rustlib/src/rust/library/core/src/lib.rs"));
    match (is_new, sources.is_some_and(|file| file.exists())) {
        (true, true) => Vec::new(),
        (true, false) => vec!["rust-web-src"],
        (false, _) => vec!["rustc-web", "rust-web-src"],
    }
}

fn is_new_enough(version: &str) -> bool {
    let mut numbers = version.split('.').map_while(|number| number.parse().ok());
    numbers.next().zip(numbers.next()).is_some_and(|version: (u32, u32)| version >= OLDEST)
}

/// Whether the library of a target lies beside a compiler.
fn has_target(rustc: &Path, target: &str) -> bool {
    let folder = printed(rustc, &["--print", "target-libdir", "--target", target]);
    folder.is_some_and(|folder| Path::new(&folder).is_dir())
}

/// The linker that every toolchain of rustup has, or that of a package.
fn linker() -> Option<PathBuf> {
    let about = printed(Path::new("rustc"), &["-vV"]);
    let host = about
        .as_deref()
        .and_then(|about| about.lines().find_map(|line| line.strip_prefix("host: ")));
    let beside = printed(Path::new("rustc"), &["--print", "sysroot"])
        .zip(host)
        .map(|(root, host)| Path::new(&root).join("lib/rustlib").join(host).join("bin/rust-lld"));
    beside.filter(|path| path.exists()).or_else(|| in_path("ld.lld"))
}

/// The version of a compiler.
fn version(rustc: &Path) -> Option<String> {
    let text = printed(rustc, &["--version"])?;
    text.split(' ').nth(1).map(str::to_owned)
}

/// What a program prints, if it is there and succeeds.
fn printed(program: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).stderr(Stdio::null()).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

/// A program of this name.
fn in_path(name: &str) -> Option<PathBuf> {
    let path = env::var_os("PATH")?;
    env::split_paths(&path).map(|folder| folder.join(name)).find(|file| file.is_file())
}

fn not_installed(machine: &Machine, missing: &str) -> Failure {
    let message = format!(
        "not installed: {missing}. As root: `apt-get update && apt-get install --no-install-recommends {missing}`; \
         `rustup target add {}` does in place of a packaged compiler",
        machine.target
    );
    Failure::new(Exit::NotRunning, message)
}

pub(super) fn started(program: &str, error: &std::io::Error) -> Failure {
    Failure::new(
        Exit::NotRunning,
        format!("`{program}` cannot be started: {}", with_sources(error)),
    )
}

/// Why cargo built nothing: that the program does not fit is an answer, all else a fault.
fn not_built(said: &str) -> Failure {
    let full = said.lines().find(|line| line.contains("will not fit in region"));
    if full.is_some() {
        let memory = if said.contains("region 'FLASH'") { "flash" } else { "RAM" };
        let message = format!("the plan and its program do not fit the board's {memory}");
        return Failure::new(Exit::Mismatch, message);
    }
    said.lines().filter(|line| line.contains("error")).for_each(|line| tell!("cargo: {line}"));
    let message = "the firmware could not be built, see above; `rustc-web` and `rust-web-src` must be of one version";
    Failure::new(Exit::NotRunning, message)
}

/// A bare processor on a board.
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
    /// Cortex-A53 without a system, with vectors (virt)
    #[value(name = "aarch64")]
    Aarch64,
}

/// What is built for a board, and what runs it.
pub(crate) struct Machine {
    /// The compiler's name of the target.
    pub(crate) target: &'static str,
    /// The linker script in `boards/`.
    pub(crate) script: &'static str,
    /// The emulator, with the arguments that make it this board. Each instruction takes the same time.
    pub(crate) emulator: &'static str,
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
            emulator: "qemu-system-riscv32 -M virt -bios none -icount shift=0",
            package: "qemu-system-misc",
            has_dsp: false,
        };
        // Of eight nanoseconds each, 24 bits of the timer are enough for 80 million instructions.
        match self {
            Self::CortexM4f => {
                let emulator = "qemu-system-arm -M mps2-an386 -icount shift=3";
                arm("thumbv7em-none-eabihf", "mps2.ld", emulator)
            }
            Self::CortexM7 => {
                let emulator = "qemu-system-arm -M mps2-an500 -icount shift=3";
                arm("thumbv7em-none-eabihf", "mps2.ld", emulator)
            }
            Self::CortexM3 => {
                let emulator = "qemu-system-arm -M mps2-an385 -icount shift=3";
                arm("thumbv7m-none-eabi", "mps2.ld", emulator)
            }
            Self::CortexM0 => {
                let emulator = "qemu-system-arm -M microbit -icount shift=3";
                arm("thumbv6m-none-eabi", "microbit.ld", emulator)
            }
            Self::Rv32imc => riscv("riscv32imc-unknown-none-elf"),
            Self::Rv32imafc => riscv("riscv32imafc-unknown-none-elf"),
            Self::Aarch64 => {
                let emulator =
                    "qemu-system-aarch64 -M virt -cpu cortex-a53 -nic none -icount shift=0";
                arm("aarch64-unknown-none", "virt64.ld", emulator)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_by_their_numbers() {
        assert!(["1.95.0", "1.100.0", "2.0.0", "1.96.0-beta.1"].into_iter().all(is_new_enough));
        assert!(!["1.94.9", "1.63.0", "0.200.0", "", "1"].into_iter().any(is_new_enough));
    }

    #[test]
    fn what_is_too_large_is_no_fault() {
        let said = "rust-lld: error: section '.rodata' will not fit in region 'FLASH': overflowed by 7 bytes";
        let failure = not_built(said);
        assert_eq!(failure.exit, Exit::Mismatch);
        assert!(failure.message.ends_with("board's flash"), "{}", failure.message);
        assert!(not_built(&said.replace("FLASH", "RAM")).message.ends_with("board's RAM"));
        assert_eq!(not_built("error: no such lang item").exit, Exit::NotRunning);
    }
}
