//! avr8js as the processor of a board: the class `Processor` of `check/avr/processor.ts`.
//!
//! JavaScript executes the instructions. It calls back for each byte on the SPI, each change of a
//! watched pin, each sample of the ADC and each time-out of the watchdog. A byte on the SPI can
//! change INT, which calls JavaScript again; so no cell is borrowed while JavaScript runs.

use std::cell::RefCell;
use std::rc::Rc;

use bench::avr::{
    Chip, Firmware, Oc, PinDriver, PinWatcher, Processor, ResetCause, SerialCharacter, SpiByte,
    SpiDevice, State, Violation, WatchdogOscillator, power_on_ram,
};
use bench::{Cycles, Noise};
use wasm_bindgen::prelude::*;

#[wasm_bindgen]
extern "C" {
    /// `Processor` of `check/avr/processor.ts`.
    pub type JsAvr;

    #[wasm_bindgen(method)]
    fn now(this: &JsAvr) -> f64;
    #[wasm_bindgen(method)]
    fn pc(this: &JsAvr) -> u32;
    #[wasm_bindgen(method, js_name = runUntil)]
    fn run_until(this: &JsAvr, until: f64) -> u8;
    #[wasm_bindgen(method)]
    fn state(this: &JsAvr) -> u8;
    #[wasm_bindgen(method)]
    fn reset(this: &JsAvr, cause: u8);
    #[wasm_bindgen(method)]
    fn pin(this: &JsAvr, port: u8, bit: u8) -> bool;
    #[wasm_bindgen(method, js_name = watchPin)]
    fn watch_pin(this: &JsAvr, port: u8, bit: u8, call: &Closure<dyn FnMut(bool, f64)>);
    #[wasm_bindgen(method, js_name = drivePin)]
    fn drive_pin(this: &JsAvr, port: u8, bit: u8, level: i8);
    #[wasm_bindgen(method, js_name = connect)]
    fn connect(
        this: &JsAvr,
        begin: &Closure<dyn FnMut(f64)>,
        end: &Closure<dyn FnMut(u8, f64, f64, u32, u8) -> u8>,
        sample: &Closure<dyn FnMut(u8) -> u32>,
        watchdog: &Closure<dyn FnMut(u8) -> f64>,
    );
    #[wasm_bindgen(method, js_name = sendSerial)]
    fn send_serial(this: &JsAvr, bytes: &[u8]);
    #[wasm_bindgen(method, js_name = takeSerial)]
    fn take_serial(this: &JsAvr) -> Vec<f64>;
    #[wasm_bindgen(method, js_name = takeEdges)]
    fn take_edges(this: &JsAvr, channel: u8) -> Vec<f64>;
    #[wasm_bindgen(method)]
    fn peek(this: &JsAvr, address: u16) -> u8;
    #[wasm_bindgen(method)]
    fn poke(this: &JsAvr, address: u16, value: u8);
    #[wasm_bindgen(method)]
    fn eeprom(this: &JsAvr) -> Vec<u8>;
}

/// State of `runUntil` for a program counter beyond the flash.
const CRASHED: u8 = 1;

/// The voltages at the ADC's inputs, in microvolts, and their noise.
struct Analog {
    inputs: [u32; 8],
    noise: Noise,
    amplitude: u32,
}

impl Analog {
    fn sample(&mut self, channel: u8) -> u32 {
        let input = self.inputs.get(usize::from(channel)).copied().unwrap_or_default();
        if self.amplitude == 0 {
            return input;
        }
        let offset = self.noise.below(2 * u64::from(self.amplitude) + 1) as u32;
        (input + offset).saturating_sub(self.amplitude)
    }
}

type SharedDevice = Rc<RefCell<Option<Box<dyn SpiDevice>>>>;

/// A chip that avr8js executes.
pub struct Avr8js {
    js: Rc<JsAvr>,
    chip: Chip,
    analog: Rc<RefCell<Analog>>,
    device: SharedDevice,
    power_on_noise: Noise,
    watchers: Vec<Closure<dyn FnMut(bool, f64)>>,
    _closures: Closures,
}

/// What JavaScript calls. Dropped with the processor.
struct Closures {
    _begin: Closure<dyn FnMut(f64)>,
    _end: Closure<dyn FnMut(u8, f64, f64, u32, u8) -> u8>,
    _sample: Closure<dyn FnMut(u8) -> u32>,
    _watchdog: Closure<dyn FnMut(u8) -> f64>,
}

/// The flash of a chip with a program: erased where the program is not.
pub fn flash_of(firmware: &Firmware, chip: Chip) -> Vec<u8> {
    let mut flash = vec![0xFF; chip.flash_bytes()];
    for (address, bytes) in &firmware.flash {
        flash[*address..address + bytes.len()].copy_from_slice(bytes);
    }
    flash
}

impl Avr8js {
    /// A chip whose flash JavaScript has, just powered on.
    pub fn new(js: JsAvr, chip: Chip) -> Avr8js {
        let analog =
            Rc::new(RefCell::new(Analog { inputs: [0; 8], noise: Noise::new(0), amplitude: 0 }));
        let device: SharedDevice = Rc::default();
        let begin = Rc::clone(&device);
        let begin = Closure::<dyn FnMut(f64)>::new(move |at: f64| {
            with_device(&begin, |device| device.begin_byte(at as Cycles));
        });
        let end = Rc::clone(&device);
        let end = Closure::<dyn FnMut(u8, f64, f64, u32, u8) -> u8>::new(
            move |mosi, start: f64, end_at: f64, cycles_per_bit: u32, mode| {
                let byte = SpiByte {
                    mosi,
                    start: start as Cycles,
                    end: end_at as Cycles,
                    cycles_per_bit: cycles_per_bit.into(),
                    mode,
                };
                with_device(&end, |device| device.end_byte(&byte)).unwrap_or(0xFF)
            },
        );
        let inputs = Rc::clone(&analog);
        let sample = Closure::<dyn FnMut(u8) -> u32>::new(move |channel| {
            inputs.borrow_mut().sample(channel)
        });
        let mut oscillator = WatchdogOscillator::new(0);
        let watchdog = Closure::<dyn FnMut(u8) -> f64>::new(move |control| {
            oscillator.time_out(control) as f64
        });
        js.connect(&begin, &end, &sample, &watchdog);
        let closures = Closures { _begin: begin, _end: end, _sample: sample, _watchdog: watchdog };
        let mut avr = Avr8js {
            js: Rc::new(js),
            chip,
            analog,
            device,
            power_on_noise: Noise::new(0),
            watchers: Vec::new(),
            _closures: closures,
        };
        avr.reset(ResetCause::PowerOn);
        avr
    }

    fn state_of(&self, number: u8) -> State {
        if number == CRASHED { State::Crashed(self.js.pc()) } else { State::Running }
    }
}

/// Calls the device, which may drive pins.
fn with_device<T>(
    device: &RefCell<Option<Box<dyn SpiDevice>>>,
    call: impl FnOnce(&mut dyn SpiDevice) -> T,
) -> Option<T> {
    let mut taken = device.take()?;
    let result = call(&mut *taken);
    device.replace(Some(taken));
    Some(result)
}

/// Number of a port for JavaScript.
fn port_number(port: char) -> u8 {
    port as u8 - b'B'
}

impl Processor for Avr8js {
    fn chip(&self) -> Chip {
        self.chip
    }

    fn now(&self) -> Cycles {
        self.js.now() as Cycles
    }

    fn run_until(&mut self, t: Cycles) -> State {
        self.state_of(self.js.run_until(t as f64))
    }

    fn state(&self) -> State {
        self.state_of(self.js.state())
    }

    fn is_halted(&self) -> bool {
        false
    }

    fn reset(&mut self, cause: ResetCause) {
        // The flags of MCUSR (section 11.9.1).
        let flag = match cause {
            ResetCause::PowerOn => 1,
            ResetCause::External => 2,
            ResetCause::BrownOut => 4,
            ResetCause::Watchdog => 8,
        };
        if cause == ResetCause::PowerOn {
            for (address, value) in power_on_ram(self.chip, &mut self.power_on_noise) {
                self.js.poke(address, value);
            }
            // The noise of a cell of the EEPROM whose programming ends here.
            self.power_on_noise.next_u64();
        }
        self.js.reset(flag);
    }

    fn pin(&self, port: char, bit: u8) -> bool {
        self.js.pin(port_number(port), bit)
    }

    fn watch_pin(&mut self, port: char, bit: u8, mut watcher: PinWatcher) {
        let call = Closure::<dyn FnMut(bool, f64)>::new(move |level, at: f64| {
            watcher(level, at as Cycles);
        });
        self.js.watch_pin(port_number(port), bit, &call);
        self.watchers.push(call);
    }

    fn drive_pin(&mut self, port: char, bit: u8, level: bool) {
        self.js.drive_pin(port_number(port), bit, level.into());
    }

    fn release_pin(&mut self, port: char, bit: u8) {
        self.js.drive_pin(port_number(port), bit, -1);
    }

    fn pin_driver(&self, port: char, bit: u8) -> PinDriver {
        let js = Rc::clone(&self.js);
        Box::new(move |level| js.drive_pin(port_number(port), bit, level.into()))
    }

    fn connect_spi(&mut self, device: Box<dyn SpiDevice>) {
        self.device.replace(Some(device));
    }

    fn serial_send(&mut self, bytes: &[u8]) {
        self.js.send_serial(bytes);
    }

    fn serial_trace(&mut self) -> Vec<SerialCharacter> {
        let numbers = self.js.take_serial();
        let (characters, _) = numbers.as_chunks::<5>();
        characters
            .iter()
            .map(|&[to_chip, start, cycles_per_bit, levels, bits]| SerialCharacter {
                to_chip: to_chip != 0.0,
                start: start as Cycles,
                cycles_per_bit: cycles_per_bit as u64,
                levels: levels as u16,
                bits: bits as u8,
            })
            .collect()
    }

    fn set_analog_uv(&mut self, channel: u8, microvolts: u32) {
        self.analog.borrow_mut().inputs[usize::from(channel)] = microvolts;
    }

    fn set_analog_noise_uv(&mut self, amplitude_uv: u32, seed: u64) {
        let mut analog = self.analog.borrow_mut();
        (analog.amplitude, analog.noise) = (amplitude_uv, Noise::new(seed));
    }

    fn take_edges(&mut self, oc: Oc) -> Vec<(Cycles, bool)> {
        let numbers = self.js.take_edges(oc as u8);
        let (edges, _) = numbers.as_chunks::<2>();
        edges.iter().map(|&[at, level]| (at as Cycles, level != 0.0)).collect()
    }

    fn oc2b_duty(&self) -> Option<f64> {
        bench::avr::oc2b_duty(|address| self.js.peek(address))
    }

    fn eeprom(&self) -> Vec<u8> {
        self.js.eeprom()
    }

    fn take_violations(&mut self) -> Vec<Violation> {
        Vec::new()
    }
}
