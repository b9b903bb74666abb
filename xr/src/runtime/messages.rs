//! What OpenXR's core-validation layer says.

use crate::XrError;
use crate::error::During;
use openxr as xr;
use openxr::sys;
use openxr::sys::Handle as _;
use std::ffi::{CStr, c_void};
use std::sync::{Arc, Mutex, PoisonError};

type List = Mutex<Vec<String>>;

/// Keeps warnings and errors for as long as it lives.
pub(super) struct Messages {
    instance: xr::Instance,
    messenger: sys::DebugUtilsMessengerEXT,
    list: Arc<List>,
}

impl Messages {
    pub fn new(instance: &xr::Instance) -> Result<Self, XrError> {
        let list = Arc::new(List::default());
        let Some(calls) = &instance.exts().ext_debug_utils else {
            return Err(XrError::Missing {
                runtime: "the active one".into(),
                wanted: "XR_EXT_debug_utils".into(),
                remedy: "Run without validation",
            });
        };
        let info = sys::DebugUtilsMessengerCreateInfoEXT {
            ty: sys::DebugUtilsMessengerCreateInfoEXT::TYPE,
            next: std::ptr::null(),
            message_severities: sys::DebugUtilsMessageSeverityFlagsEXT::WARNING
                | sys::DebugUtilsMessageSeverityFlagsEXT::ERROR,
            message_types: sys::DebugUtilsMessageTypeFlagsEXT::GENERAL
                | sys::DebugUtilsMessageTypeFlagsEXT::VALIDATION
                | sys::DebugUtilsMessageTypeFlagsEXT::CONFORMANCE,
            user_callback: Some(on_message),
            user_data: Arc::as_ptr(&list).cast_mut().cast(),
        };
        let mut messenger = sys::DebugUtilsMessengerEXT::NULL;
        // SAFETY: the list outlives the messenger: both are fields of what is returned, and drop destroys the latter.
        let result =
            unsafe { (calls.create_debug_utils_messenger)(instance.as_raw(), &info, &mut messenger) };
        if result.into_raw() < 0 {
            return Err(result).during("xrCreateDebugUtilsMessengerEXT");
        }
        Ok(Self { instance: instance.clone(), messenger, list })
    }

    pub fn list(&self) -> Vec<String> {
        self.list.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Messages {
    fn drop(&mut self) {
        if let Some(calls) = &self.instance.exts().ext_debug_utils {
            // SAFETY: made by this instance, and destroyed once.
            unsafe { (calls.destroy_debug_utils_messenger)(self.messenger) };
        }
    }
}

/// Keeps what the layer says.
unsafe extern "system" fn on_message(
    _: sys::DebugUtilsMessageSeverityFlagsEXT,
    _: sys::DebugUtilsMessageTypeFlagsEXT,
    data: *const sys::DebugUtilsMessengerCallbackDataEXT,
    user: *mut c_void,
) -> sys::Bool32 {
    let text = |p: *const std::ffi::c_char| {
        // SAFETY: the layer passes terminated strings, or null.
        (!p.is_null()).then(|| unsafe { CStr::from_ptr(p) }.to_string_lossy().into_owned())
    };
    // SAFETY: the layer passes a valid structure, and `user` is the list that `Messages::new` gave, still alive.
    if let (Some(data), Some(list)) = unsafe { (data.as_ref(), user.cast::<List>().as_ref()) } {
        let function = text(data.function_name).unwrap_or_default();
        let message = text(data.message).unwrap_or_default();
        log::error!("OpenXR validation: {function}: {message}");
        list.lock().unwrap_or_else(PoisonError::into_inner).push(format!("{function}: {message}"));
    }
    sys::FALSE
}
