//! Moves Monado's remote-controlled headset and controllers: the packets of the pinned version, 25.0.0.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

const MAGIC: &[u8; 8] = b"mndrmt3\0";
/// Bytes of the magic, the head and two controllers.
const PACKET: usize = 8 + 128 + 2 * 120;

/// A pose: quaternion `(x, y, z, w)` and place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RemotePose(pub [f32; 4], pub [f32; 3]);

impl RemotePose {
    /// Unturned, somewhere.
    pub fn at(place: [f32; 3]) -> Self {
        Self([0.0, 0.0, 0.0, 1.0], place)
    }
}

/// A controller.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "the names say it")]
pub struct RemoteHand {
    pub pose: RemotePose,
    pub trigger: f32,
    pub squeeze: f32,
    pub stick: [f32; 2],
    pub a: bool,
    pub b: bool,
    /// A bare hand instead of a controller, with this curl of its fingers from the thumb on, `0 ..= 1`.
    pub bare: Option<[f32; 5]>,
}

/// Head and hands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Remote {
    /// The head's middle.
    pub head: RemotePose,
    /// Each eye, measured from the head's middle.
    pub eyes: [RemotePose; 2],
    /// Angles to the left, right, upper and lower edge of each eye's image, radians.
    pub fovs: [[f32; 4]; 2],
    /// Left and right.
    pub hands: [RemoteHand; 2],
}

impl Default for Remote {
    fn default() -> Self {
        let hand = |x| RemoteHand {
            pose: RemotePose::at([x, 1.2, -0.4]),
            trigger: 0.0,
            squeeze: 0.0,
            stick: [0.0; 2],
            a: false,
            b: false,
            bare: None,
        };
        Self {
            head: RemotePose::at([0.0, 1.6, 0.0]),
            eyes: [RemotePose::at([-0.032, 0.0, 0.0]), RemotePose::at([0.032, 0.0, 0.0])],
            fovs: [[-0.9, 0.7, 0.8, -0.85], [-0.7, 0.9, 0.8, -0.85]],
            hands: [hand(-0.2), hand(0.2)],
        }
    }
}

impl Remote {
    fn packet(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let floats = |bytes: &mut Vec<u8>, values: &[f32]| {
            bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        };
        let pose = |bytes: &mut Vec<u8>, RemotePose(turn, place): &RemotePose| {
            floats(bytes, turn);
            floats(bytes, place);
        };
        for (eye, fov) in self.eyes.iter().zip(&self.fovs) {
            floats(&mut bytes, fov);
            pose(&mut bytes, eye);
            bytes.extend([0; 4]);
        }
        pose(&mut bytes, &self.head);
        // Each eye has a pose and a field of view of its own.
        bytes.extend([1, 0, 0, 0]);
        for hand in &self.hands {
            pose(&mut bytes, &hand.pose);
            // Velocities and the curl of five fingers, from the little one on.
            floats(&mut bytes, &[0.0; 6]);
            let mut curls = hand.bare.unwrap_or_default();
            curls.reverse();
            floats(&mut bytes, &curls);
            floats(&mut bytes, &[hand.trigger, hand.squeeze, 0.0]);
            floats(&mut bytes, &hand.stick);
            // The trackpad's force and place.
            floats(&mut bytes, &[0.0; 3]);
            let trigger = u8::from(hand.trigger > 0.5);
            // A tracked hand or an active controller; system, a, b, trigger, stick, pad: click and touch each.
            bytes.extend([
                u8::from(hand.bare.is_some()),
                u8::from(hand.bare.is_none()),
                0,
                0,
                u8::from(hand.a),
                0,
                u8::from(hand.b),
                0,
                trigger,
                0,
                0,
                0,
                0,
                0,
                0,
                0,
            ]);
        }
        assert_eq!(bytes.len(), PACKET);
        bytes
    }
}

/// The connection to the service.
pub struct RemoteControl {
    stream: TcpStream,
}

impl RemoteControl {
    /// Connects to the port that the test was told.
    ///
    /// # Panics
    /// Where the service does not listen, or speaks another version.
    #[allow(clippy::expect_used, clippy::panic, reason = "only tests call it")]
    pub fn connect() -> Self {
        let port = std::env::var("MOTES_TEST_PORT").expect("the remote control's port");
        let port: u16 = port.parse().expect("a port");
        let begun = Instant::now();
        let mut stream = loop {
            match TcpStream::connect(("127.0.0.1", port)) {
                Ok(stream) => break stream,
                Err(e) if begun.elapsed() > Duration::from_secs(20) => panic!("the remote control: {e}"),
                Err(_) => std::thread::sleep(Duration::from_millis(20)),
            }
        };
        // It greets with where everything is at first, and where it is now.
        let mut greeting = [0; 2 * PACKET];
        stream.read_exact(&mut greeting).expect("the remote control's greeting");
        // The head's turn, of length 1 where the packet is the one that we know.
        let float = |at: usize| f32::from_le_bytes([0, 1, 2, 3].map(|i| greeting[at + i]));
        let length: f32 = (0..4).map(|i| float(8 + 96 + 4 * i).powi(2)).sum();
        assert!((length - 1.0).abs() < 1e-3, "Monado's remote control is of another version: {greeting:?}");
        let mut control = Self { stream };
        control.send(&Remote::default());
        control
    }

    /// Sets head and hands.
    ///
    /// # Panics
    /// Where the service is gone.
    #[allow(clippy::expect_used, reason = "only tests call it")]
    pub fn send(&mut self, remote: &Remote) {
        self.stream.write_all(&remote.packet()).expect("the remote control takes the packet");
    }
}
